"""One function that loads any file or folder of tactorch, and meshes."""

from pathlib import Path
from typing import Any

from tactorch.errors import FileError
from tactorch.files import read_json
from tactorch.hdf5 import open_hdf5

__all__ = ["load"]
_READABLE = (
    "recordings and reconstructions (.h5), shapes (.json), meshes (.msh, .vtu, .inp), sensors"
    " (.yaml), calibrations (.npz), and folders of datasets and runs"
)


def load(path: str | Path) -> Any:
    """Load a file or folder by what it contains.

    | file or folder | object |
    |---|---|
    | `.h5` of `Recording.save` or a command | `Recording` |
    | `.h5` of `Reconstruction.save`, folder of a run of `tactorch invert` | `Reconstruction` |
    | `shapes.json` of `tactorch live`, and of runs of earlier versions | `ShapeReconstruction` |
    | folder of `tactorch generate` | `SampleSet` |
    | `.msh`, `.vtu`, `.inp` | `TetMesh`, of a mesh in mm; `read_mesh` takes other units |
    | `.yaml` of a sensor | `SensorDescription` |
    | `.npz` of `tactorch sensor calibrate` | `Calibration` |

    Args:
        path: File or folder.

    Raises:
        FileError: It does not exist, is damaged, or is none of these; names it and what to do.
        MeshError: A mesh cannot be used.
        RecordingError: A recording is not valid.
    """
    source = Path(path)
    if source.is_dir():
        return _folder(source)
    match source.suffix.lower():
        case ".h5" | ".hdf5":
            return _hdf5(source)
        case ".json":
            return _shapes(source)
        case ".msh" | ".vtu" | ".inp":
            from tactorch.mesh import read_mesh

            return read_mesh(source)
        case ".yaml" | ".yml":
            from tactorch.sensor.description import load_sensor

            return load_sensor(source)
        case ".npz":
            from tactorch.sensor.calibration import load_calibration

            return load_calibration(source)
        case ".stl" | ".obj" | ".ply":
            problem = f"is a surface; `tactorch mesh {path}` makes a mesh of its inside."
        case _:
            problem = f"cannot be loaded: tactorch loads {_READABLE}."
    raise FileError(f"'{path}' {problem}")


def _folder(folder: Path) -> Any:
    from tactorch.generation import SampleSet
    from tactorch.inverse import Reconstruction

    if (folder / "manifest.json").is_file():
        return SampleSet.load(folder)
    if (folder / "reconstruction.h5").is_file():
        return Reconstruction.load(folder / "reconstruction.h5")
    raise FileError(
        f"'{folder}' is no dataset (manifest.json) and no run of `tactorch invert`"
        " (reconstruction.h5); check the path."
    )


def _hdf5(path: Path) -> Any:
    from tactorch.inverse import Reconstruction
    from tactorch.recording import Recording

    with open_hdf5(path, "file", "make it again with tactorch.") as file:
        kind = file.attrs.get("format", b"")
    if kind in (b"tactorch-reconstruction", "tactorch-reconstruction"):
        return Reconstruction.load(path)
    return Recording.load(path)  # which refuses what is none


def _shapes(path: Path) -> Any:
    from tactorch.inverse import ShapeReconstruction

    content = read_json(path, "shapes", "run `tactorch find` again.")
    try:
        return ShapeReconstruction.of(content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileError(
            f"'{path}' has no shapes of `tactorch invert` or `tactorch find` ({error!r}); give"
            " shapes.json of a run."
        ) from error
