"""Make the pictures of the gallery.

    python docs/images/make_gallery.py

They are of presses that are simulated on finer meshes of quadratic elements that follow the
inclusions. The pictures of the report and of a live session are screenshots.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tactorch import PressPlan, Settings, invert, make_phantom, simulate
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact import Ball
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.mesh import Box, Cylinder, Sphere, box_mesh, face_nodes
from tactorch.phantoms import Phantom
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording
from tactorch.viz import comparison_figure, convergence_figure, save_figure
from tactorch.viz.figures import surface_figure

OUT = Path(__file__).parent / "gallery"


def first_inversion() -> None:
    """A ball in a cube: slices, view in 3-D, and a comparison of priors of the element map."""
    phantom = make_phantom("cube_sphere", depth=0.4)
    sides, mesh = ("z+", "x+", "y+"), phantom.mesh(2.0)
    recording = simulate(
        phantom, PressPlan(sides, p_max_mpa=0.02, steps=4), mesh=mesh, samples=4,
        fine_mesh=phantom.mesh(1.2, conforming=True), element="tet10", snr_db=40,
    )  # fmt: skip
    priors = ("total_variation", "tikhonov", "log_jumps")
    result = invert(recording)
    save_figure(result.plot(), OUT / "finding.png", dpi=60)
    result.show(screenshot=OUT / "view.png")
    runs = {name: invert(recording, Settings(method="map", regularization=name)) for name in priors}
    both = replace(result, other=runs["total_variation"])
    save_figure(both.plot(truth=recording.truth), OUT / "descriptions.png", dpi=60)
    save_figure(comparison_figure(runs), OUT / "comparison.png", dpi=55)
    save_figure(
        convergence_figure({n: r.history for n, r in runs.items()}), OUT / "convergence.png", dpi=60
    )
    once = simulate(phantom, PressPlan(sides, [0.02]), mesh=mesh, element="tet10", snr_db=40)
    save_figure(once.plot(), OUT / "presses.png", dpi=55)


def ring() -> None:
    """The torus of the paper in a cube: slices of what is found, and of the truth."""
    phantom = make_phantom("cube_torus")
    recording = simulate(
        phantom, PressPlan(("z+", "x+", "y+"), p_max_mpa=0.02, steps=4), mesh=phantom.mesh(1.4),
        fine_mesh=phantom.mesh(0.9, conforming=True), element="tet10", snr_db=40,
    )  # fmt: skip
    result = invert(recording)
    print(result.summary())
    save_figure(result.plot(truth=recording.truth), OUT / "ring.png", dpi=60)


def palpation() -> None:
    """Forces on a ball at many places of a block with a nodule."""
    lump, radius = np.array([3.0, -2.0, -4.0]), 3.0
    mesh = box_mesh((24.0, 24.0, 10.0), (16, 16, 7), center_mm=(0.0, 0.0, -5.0), tets_per_cell=5)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    body = SoftBody(mesh, make_material("linear", 0.45), element="tet10")
    axis = np.arange(-8.0, 8.1, 2.0)
    where = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    up = np.array([0.0, 0.0, 1.0])
    places = [BallPlace(np.array([*xy, 0.0]), up, 3.0, 1.0) for xy in where]
    youngs = np.where(np.linalg.norm(mesh.centroids - lump, axis=1) < radius, 0.5, 0.05)
    nothing = np.zeros((mesh.n_points, 3))
    forces = Indentation(body, Supports(fixed, nothing, nothing), places).at(youngs).press(
        np.arange(len(places)), np.ones(len(places))
    ).force_n  # fmt: skip
    presses = [
        Press.by_probe(
            ProbePose(Ball(3.0), np.array([*xy, 2.0])), mesh.n_points,
            force=ForceReading.along(up, float(force), 0.003), fixed=fixed,
        )
        for xy, force in zip(where, forces, strict=True)
    ]  # fmt: skip
    recording = Recording(mesh, tuple(presses), MaterialSpec("linear", 0.45))
    save_figure(recording.plot(), OUT / "palpation.png", dpi=60)


def bodies() -> None:
    """A body with two inclusions, meshed so that elements follow them."""
    body = Cylinder(radius_mm=12.0, height_mm=14.0)
    phantom = Phantom(
        body, [(Sphere((4.0, 0.0, 1.0), 3.0), 0.3), (Box((-5.0, 0.0, 0.0), (4.0, 6.0, 4.0)), 0.1)],
        youngs_mpa=0.03,
    )  # fmt: skip
    save_figure(phantom.plot(), OUT / "phantom.png", dpi=60)
    mesh = phantom.mesh(2.5)
    save_figure(surface_figure(mesh), OUT / "mesh.png", dpi=60)


if __name__ == "__main__":
    OUT.mkdir(exist_ok=True)
    first_inversion()
    ring()
    palpation()
    bodies()
