"""`tactorch body`: mesh an object from a labelled volume, such as a segmentation of CT or MRI.

    tactorch body volume=labels.nii.gz out=body.vtu edge_length_mm=3
    tactorch body volume=labels.nii.gz out=body.vtu "labels={1: tissue, 2: nodule}"
    tactorch body volume=segmentation.dcm out=body.vtu labels=[1,2] keep_largest=true
    tactorch body volume=labels.npy out=body.vtu spacing_mm=[0.5,0.5,1]

Each element has the label of most of its volume as its region, which the file has as the cell data
region. Priors and initializations take a modulus for each region.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, write_mesh
from tactorch.volumes import Body, BodySettings, read_body

_SUFFIXES = (".vtu", ".msh")


@dataclass(frozen=True, kw_only=True)
class BodyOptions(BodySettings, UnitCheck, CommandOptions):
    """Settings of the command."""

    volume: Path = option(help="NIfTI, DICOM segmentation, .npz or .npy with a label per voxel")
    out: Path = option(help="Mesh to write (.vtu or .msh)")
    edge_length_mm: float | None = option(
        None, "Edge length of the mesh; null: a tenth of the body's diagonal", unit="mm", gt=0
    )
    max_elements: int = option(500_000, "Limit of the expected number of elements", ge=1)


def run(options: BodyOptions) -> Path:
    """Mesh the body and write it; returns its path."""
    if options.out.suffix.lower() not in _SUFFIXES:
        raise ConfigError(f"out={options.out}: give a name that ends in .vtu or .msh.")
    body = read_body(options.volume, options, check_units=options.check_units)
    length = body.check_edge_length(options.edge_length_mm, options.max_elements)
    log.info("meshing %.4g mm3 with edges of %.3g mm ...", body.volume_mm3, length)
    mesh = body.mesh(length, max_elements=options.max_elements)
    write_mesh(options.out, mesh)
    size = " x ".join(f"{edge:.3g}" for edge in mesh.bounds[1] - mesh.bounds[0])
    log.info("body: %s mm, %d nodes, %d tetrahedra", size, mesh.n_points, mesh.n_tets)
    log_text("", _table(body, mesh))
    log.info("mesh: %s", options.out)
    return options.out


def _table(body: Body, mesh: TetMesh) -> Table:
    """Return the volumes of the regions, in the file and in the mesh."""
    volume, regions = body.volume, mesh.regions
    assert regions is not None
    rows = []
    for number in volume.numbers.tolist():
        mine = regions == number
        voxels = float(np.count_nonzero(volume.labels == number)) * volume.voxel_mm3
        values = f"{voxels:.4g}", f"{mesh.volumes[mine].sum():.4g}", str(mine.sum())
        rows.append([volume.name(number), *values])
        if not mine.any():
            log.warning(
                "region %s has no element: it is smaller than half an element; give a smaller "
                "edge_length_mm.", volume.name(number),
            )  # fmt: skip
    return Table(["region", "voxels, mm3", "elements, mm3", "elements"], rows)
