"""The text format of the published tactile-elastography cases.

A folder holds (n nodes, m tetrahedra; degrees of freedom are x y z of node 0, of node 1, ...):

| file | what | unit |
|---|---|---|
| mesh.msh | gmsh tetrahedra | m |
| presses/force<i>.txt | 3n external nodal forces | N |
| presses/pnt<i>.txt | 3n coordinates of the deformed nodes | m |
| presses/A-<i>.txt | `row col value`: zero-length springs that hold the object | N/m |
| presses/B-<i>.txt | `row col 1`: observed degrees of freedom | |
| youngs_true.txt | m true moduli, may be absent | Pa |
| youngs_reference_result.txt | m reconstructed moduli of the authors, may be absent | Pa |

Any number of presses, numbered in any way. Forward solves show what the files do not state: the
authors' solver used the mesh with six decimals of a metre (`round_rest_m`), halved the volume term
of the paper's energy (`lame_factor`), and the truth of one case is not that of its presses
(`relabel_truth`). Equation (3) of the paper squares the stiffness of the springs if read literally;
in the files the force is stiffness times displacement.
"""

import math
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.budget import TEXT, read_content
from tactorch.config import Options, option
from tactorch.errors import FileError, RecordingError
from tactorch.files import require_file, require_folder
from tactorch.importers.loads import push_direction
from tactorch.mesh import TetMesh, read_mesh
from tactorch.mesh.io import PLAUSIBLE_MM
from tactorch.recording import MaterialSpec, Press, Recording

_MM_PER_M = 1e3
_PA_PER_MPA = 1e6
_PARTS = {
    "force": "nodal forces",
    "pnt": "deformed positions",
    "A-": "springs",
    "B-": "observed degrees of freedom",
}
# Moduli below look like MPa or kPa: soft tissue has a kPa or more.
_SMALLEST_PA = 100.0
_OPT_OUT = "If the numbers are right, pass check_units=False."
# A level of the truth is meant when it is this close to the number given for it.
_LEVEL_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True)
class PublishedOptions(Options):
    """Read a case in the published text format (see the module's docstring)."""

    section: ClassVar[str] = "format"
    poisson: float = option(0.49, "Poisson's ratio of the material")
    lame_factor: float = option(
        0.5, "Factor on Lame's first parameter; the published presses have 0.5"
    )
    round_rest_m: float | None = option(
        1e-6,
        "Round rest positions to multiples of this, m; None leaves them. Without it the published"
        " cases have a constant pre-stress in every press",
        gt=0,
    )
    relabel_truth: Mapping[float, float] | None = option(
        None,
        "Moduli of the truth to correct, from given to right value, MPa. The published box-torus"
        " needs `{3.0: 1.5}`",
    )
    noise_mm: float | None = option(
        None, "Standard deviation of the noise of the positions, mm, if known"
    )
    check_units: bool = option(
        True, "Refuse magnitudes that suggest a wrong unit, as `Recording` does"
    )

    def __call__(self, *, path: str | Path) -> Recording:
        """Read the case in a folder; see `import_published`."""
        root = require_folder(path, "published case")
        mesh = _read_rest(root / "mesh.msh", self.round_rest_m, self.check_units)
        numbers = _press_files(require_folder(root / "presses", "presses of the published case"))
        presses = [_read_press(n, files, mesh, self.noise_mm) for n, files in numbers.items()]
        truth_file = root / "youngs_true.txt"
        reference_file = root / "youngs_reference_result.txt"
        truth = _read_moduli(truth_file, "true moduli", mesh, self.check_units)
        relabel = self.relabel_truth or {}
        provenance = {
            "importer": "published",
            "inverse_crime": True,  # the authors solved the presses on this very mesh
            "case": root.resolve().name,
            "presses": list(numbers),
            "round_rest_m": self.round_rest_m,
            "relabel_truth": [[old, new] for old, new in relabel.items()],
        }
        return Recording(
            mesh,
            tuple(_with_steps(presses)),
            MaterialSpec("neo_hookean", self.poisson, {"lame_factor": self.lame_factor}),
            truth=_relabelled(truth, relabel, truth_file),
            reference=_read_moduli(reference_file, "reference moduli", mesh, self.check_units),
            provenance=provenance,
            check_units=self.check_units,
        )


def import_published(folder: str | Path, **options: Any) -> Recording:
    """Read a case in the published text format (see the module's docstring).

    Args:
        folder: The folder of the case.
        options: Settings, see `PublishedOptions`.

    Returns:
        A recording with presses in order of their numbers, `direction` the unit vector of the
        total force, and `step` the rank of a press by force among those of the same direction and
        supports.

    Raises:
        ConfigError: A setting is not valid.
        FileError: A file is missing or malformed; names file, line where it can, and remedy.
        MeshError: The mesh cannot be used.
        RecordingError: The files are readable but do not make a valid recording.
    """
    return PublishedOptions(**options)(path=folder)


def _read_rest(path: Path, round_rest_m: float | None, check_units: bool) -> TetMesh:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # reported below as an error
        source = require_file(path, "mesh of the published case")
        mesh = read_mesh(source, unit="m", drop_unreferenced=False)
    low, high = PLAUSIBLE_MM
    if check_units and not low <= mesh.diagonal <= high:
        raise FileError(
            f"'{path}' is {mesh.diagonal / _MM_PER_M:.3g} m across, which no pressed object is; "
            f"this format is in metres: convert mesh and positions. {_OPT_OUT}"
        )
    if round_rest_m is None:
        return mesh
    # Dividing by a whole number of steps per metre keeps the decimals exact (0.005 m is 5 mm).
    steps_per_mm = 1 / (round_rest_m * _MM_PER_M)
    return TetMesh.create(np.round(mesh.points * steps_per_mm) / steps_per_mm, mesh.tets)


def _press_files(folder: Path) -> dict[int, dict[str, Path]]:
    """Find the files of each press: number -> part -> path, in order of the numbers."""
    pattern = re.compile(rf"({'|'.join(_PARTS)})(\d+)\.txt")
    presses: dict[int, dict[str, Path]] = {}
    for path in sorted(folder.iterdir()):
        match = pattern.fullmatch(path.name)
        if match is None:
            continue
        files = presses.setdefault(int(match[2]), {})
        if match[1] in files:
            raise FileError(
                f"'{path}' and '{files[match[1]]}' have the same press number; remove one"
            )
        files[match[1]] = path
    if not presses:
        raise FileError(
            f"'{folder}' holds no press; files force1.txt, pnt1.txt, A-1.txt, B-1.txt are needed"
        )
    for number, files in sorted(presses.items()):
        for part, what in _PARTS.items():
            if part not in files:
                raise FileError(
                    f"press {number} lacks '{folder / f'{part}{number}.txt'}' ({what}); "
                    f"add it, or remove the other files of press {number}"
                )
    return dict(sorted(presses.items()))


def _read_press(
    number: int, files: dict[str, Path], mesh: TetMesh, noise_mm: float | None
) -> Press:
    size = 3 * mesh.n_points
    reason = f"x y z for each of the {mesh.n_points} nodes of the mesh"
    forces = _read_numbers(files["force"], "nodal forces", size, reason).reshape(-1, 3)
    deformed_m = _read_numbers(files["pnt"], "deformed positions", size, reason).reshape(-1, 3)
    span, rest = float(np.linalg.norm(np.ptp(deformed_m, axis=0))), mesh.diagonal / _MM_PER_M
    if not 0.1 < span / rest < 10.0:
        raise FileError(
            f"'{files['pnt']}' holds deformed positions {span:.3g} m across, of a mesh {rest:.3g} m"
            " across; both must be in metres: convert the one that is not"
        )
    springs = _read_diagonal(files["A-"], "springs", size).reshape(-1, 3) / _MM_PER_M
    observed = _read_diagonal(files["B-"], "observed degrees of freedom", size).reshape(-1, 3)
    invalid = observed[(observed != 0) & (observed != 1)]
    if len(invalid):
        raise FileError(
            f"'{files['B-']}' has the value {invalid[0]:g}; an observed degree of freedom has the"
            " value 1"
        )
    try:
        return Press(
            forces,
            observed == 1,
            deformed_m * _MM_PER_M - mesh.points,
            springs=springs,
            noise_mm=noise_mm,
            direction=push_direction(forces),
            name=str(number),
        )
    except RecordingError as error:
        raise RecordingError(f"'{files['force'].parent}', {error}") from error


def _with_steps(presses: list[Press]) -> list[Press]:
    """Number the load steps of presses that share direction and supports, lightest first."""
    kinds: dict[tuple[bytes, bytes], list[Press]] = {}
    for press in presses:
        push = np.zeros(3) if press.direction is None else press.direction
        # Adding zero makes -0.0 and 0.0 the same bytes.
        key = ((np.round(push, 6) + 0.0).tobytes(), press.springs.tobytes())
        kinds.setdefault(key, []).append(press)
    steps: dict[str, int] = {}
    for kind in kinds.values():
        kind.sort(key=lambda press: float(np.linalg.norm(press.total_force)))
        steps.update({press.name: step for step, press in enumerate(kind)})
    return [replace(press, step=steps[press.name]) for press in presses]


def _read_moduli(
    path: Path, what: str, mesh: TetMesh, check_units: bool
) -> Float[np.ndarray, " m"] | None:
    if not path.exists():
        return None
    reason = f"one for each of the {mesh.n_tets} tetrahedra of the mesh"
    values_pa = _read_numbers(path, what, mesh.n_tets, reason)
    middle = float(np.median(values_pa))
    if check_units and 0 < middle < _SMALLEST_PA:
        raise FileError(
            f"'{path}' has a median of {middle:.3g} Pa, softer than anything one can press; this "
            f"format is in Pa: convert from MPa or kPa. {_OPT_OUT}"
        )
    return values_pa / _PA_PER_MPA


def _relabelled(
    truth: Float[np.ndarray, " m"] | None, relabel: Mapping[float, float], path: Path
) -> Float[np.ndarray, " m"] | None:
    if not relabel:
        return truth
    if truth is None:
        raise FileError(f"relabel_truth is given, but '{path}' does not exist; leave it out")
    corrected = truth.copy()
    for old, new in relabel.items():
        matches = np.isclose(truth, old, rtol=_LEVEL_TOLERANCE, atol=0.0)
        if not matches.any():
            levels = np.unique(truth)
            shown = ", ".join(f"{level:g}" for level in levels)
            if len(levels) > 6:
                shown = f"{len(levels)} different ones from {levels[0]:g} to {levels[-1]:g}"
            raise RecordingError(
                f"relabel_truth: no element of '{path}' has {old:g} MPa; its moduli are "
                f"{shown} MPa. Name one of these, in MPa"
            )
        corrected[matches] = new
    return corrected


def _read_numbers(path: Path, what: str, count: int, reason: str) -> Float[np.ndarray, " k"]:
    """Read exactly `count` finite numbers, separated by white space or line ends.

    Messages name the expected content `what`, and the `reason` for the count.
    """
    values = [value for _, _, numbers in _rows(path, what) for value in numbers]
    if len(values) != count:
        raise FileError(
            f"'{path}' holds {len(values)} numbers; {what} needs {count} ({reason}). "
            "Is it cut short, or of another mesh?"
        )
    return np.array(values, dtype=np.float64)


def _read_diagonal(path: Path, what: str, size: int) -> Float[np.ndarray, " k"]:
    """Read the diagonal of a matrix of `size` rows given as lines of `row col value`, from 0.

    Entries off the diagonal, given twice or negative are refused; the others are 0.
    """
    diagonal = np.zeros(size)
    line_of: dict[int, int] = {}
    for line, tokens, numbers in _rows(path, what):
        where = f"'{path}' line {line}"
        row, value = _entry(tokens, numbers, where, size)
        if row in line_of:
            raise FileError(
                f"{where} repeats degree of freedom {row} of line {line_of[row]}; keep one of the"
                " two"
            )
        line_of[row] = line
        diagonal[row] = value
    return diagonal


def _entry(tokens: list[str], numbers: list[float], where: str, size: int) -> tuple[int, float]:
    if len(numbers) != 3:
        raise FileError(f"{where} is {' '.join(tokens)!r}; 'row col value' is needed")
    row, column, value = numbers
    for index in (row, column):
        if index != int(index) or not 0 <= index < size:
            raise FileError(
                f"{where} names degree of freedom {tokens[0]} {tokens[1]}, but the mesh has "
                f"{size} (0 to {size - 1}: x y z of node 0, of node 1, ...). Is the file of "
                "another mesh, or counted from 1?"
            )
    if row != column:
        raise FileError(
            f"{where} is off the diagonal ({tokens[0]}, {tokens[1]}); only the diagonal has a "
            "meaning here: each degree of freedom on its own"
        )
    if value < 0:
        raise FileError(f"{where} has the negative value {tokens[2]}; give one of at least 0")
    return int(row), value


def _rows(path: Path, what: str) -> Iterator[tuple[int, list[str], list[float]]]:
    """Yield the number, the words and the finite numbers of each line that is not empty."""
    try:
        lines = read_content(require_file(path, what), TEXT).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FileError(f"'{path}' is not a text file: {error}; give numbers as text") from error
    for line, words in enumerate(map(str.split, lines), start=1):
        if words:
            yield line, words, [_number(word, path, line) for word in words]


def _number(token: str, source: Path, line: int) -> float:
    try:
        value = float(token)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileError(
            f"'{source}' line {line} has {token!r}, which is not a finite number; "
            "repair the line, or leave out the press it belongs to"
        )
    return value
