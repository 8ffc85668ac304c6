"""`tactorch mesh`: tetrahedra inside a closed triangle surface, of a given edge length.

    tactorch mesh part.stl edge_length_mm=2 out=part.vtu
    tactorch mesh surface=scan.ply unit=m edge_length_mm=5 out=scan.msh largest=true

The median edge length is within about 20 % of edge_length_mm. Where curvature or small features
need smaller elements, a warning tells the median.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tactorch.cli.console import Table, log, log_text, progress
from tactorch.cli.settings import CommandOptions, UnitCheck
from tactorch.config import option
from tactorch.errors import ConfigError, FileError
from tactorch.mesh import TetMesh, read_surface, tetrahedralize, write_mesh
from tactorch.mesh.edge_length import mean_ratios
from tactorch.mesh.geometry import bounding_diagonal, enclosed_volume
from tactorch.mesh.io import MESH_SUFFIXES, PLAUSIBLE_MM, naming
from tactorch.mesh.solids import solid_surface
from tactorch.mesh.values import Points, Triangles

_REGULAR = 0.118  # volume of a regular tetrahedron of edge 1
_THIN = 0.05  # quality of an element below which a warning is due


@dataclass(frozen=True, kw_only=True)
class MeshOptions(UnitCheck, CommandOptions):
    """Settings of the command."""

    surface: Path = option(help="Closed triangle surface (.stl, .obj, .ply)")
    edge_length_mm: float = option(help="Median edge length", unit="mm", gt=0)
    out: Path = option(help="Mesh to write (.vtu, .msh, .inp), in mm")
    unit: Literal["mm", "cm", "m"] = option("mm", "Length unit of the surface")
    largest: bool = option(False, "Keep only the part of the largest volume")
    max_elements: int = option(
        500_000, "Expected number of elements above which the edge length is refused", ge=1
    )
    cache: bool = option(True, "Return the mesh made before of the same surface and edge length")


def run(options: MeshOptions) -> Path:
    """Mesh a surface and write the mesh; returns its path."""
    if options.out.suffix.lower() not in MESH_SUFFIXES:
        raise FileError(
            f"out={options.out}: the suffix '{options.out.suffix}' is unknown; use one of "
            f"{', '.join(MESH_SUFFIXES)}."
        )
    points, faces = _read(options)
    volume = enclosed_volume(points, faces)
    expected = volume / (_REGULAR * options.edge_length_mm**3)
    if expected > options.max_elements:
        raise ConfigError(
            f"edge_length_mm={options.edge_length_mm:g} would take about {expected:.2g} elements "
            f"for {volume:.3g} mm^3 (max_elements={options.max_elements}); choose a larger one,"
            " and check unit."
        )
    log.info("Meshing %d triangles: about %.2g elements ...", len(faces), expected)
    with progress("meshing", "meshes") as update:
        mesh = tetrahedralize(
            points, faces, options.edge_length_mm, cache=options.cache, progress=update
        )
    write_mesh(options.out, mesh)
    _describe(mesh, options.edge_length_mm, len(faces), volume)
    log.info("mesh: %s", options.out)
    return options.out


def _read(options: MeshOptions) -> tuple[Points, Triangles]:
    """Return the surface, in mm."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of the unit, reported as an error below
        points, faces = read_surface(options.surface, options.unit)
    diagonal, (low, high) = bounding_diagonal(points), PLAUSIBLE_MM
    if options.check_units and not low < diagonal < high:
        raise FileError(
            f"'{options.surface}' is {diagonal:.3g} mm across with unit={options.unit}; give the "
            "unit of its coordinates, or pass check_units=false."
        )
    if options.edge_length_mm > (np.ptp(points, axis=0)).max():
        raise ConfigError(
            f"edge_length_mm={options.edge_length_mm:g} exceeds the size of '{options.surface}', "
            f"{' x '.join(f'{size:.3g}' for size in np.ptp(points, axis=0))} mm; choose a smaller"
            " one, and check unit."
        )
    with naming(options.surface):
        return solid_surface(points, faces, largest=options.largest)


def _describe(mesh: TetMesh, target_mm: float, triangles: int, volume: float) -> None:
    lengths, quality = mesh.edge_lengths, mean_ratios(mesh)
    low, median, high = np.percentile(lengths, (5, 50, 95))
    rows = [
        ("surface", f"{triangles} triangles, {volume:.4g} mm^3"),
        ("nodes", f"{mesh.n_points}, {len(mesh.surface.nodes())} on the surface"),
        ("elements", f"{mesh.n_tets}"),
        ("median edge", f"{median:.3g} mm (target {target_mm:g}; 90 % {low:.3g} to {high:.3g})"),
        ("volume", f"{mesh.volumes.sum():.4g} mm^3 ({mesh.volumes.sum() / volume - 1.0:+.1%})"),
        ("quality", f"median {np.median(quality):.2f}, least {quality.min():.2f} (regular: 1)"),
    ]
    log_text(Table(("", ""), rows, words=2))
    if quality.min() < _THIN:
        log.warning(
            "%d elements are thin (quality below %g); another edge_length_mm may avoid them.",
            (quality < _THIN).sum(), _THIN,
        )  # fmt: skip
