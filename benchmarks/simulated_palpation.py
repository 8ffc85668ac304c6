"""A simulated palpation of any number of probes, to measure time and memory.

    python benchmarks/simulated_palpation.py SIDE OUT

A ball is pressed into a block with a stiff ball in it, at SIDE x SIDE places to three depths. The
forces are computed with quadratic elements on a finer mesh than that of the recording OUT, with
noise. 48 x 48 places take some minutes.
"""

import sys

import numpy as np

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact import Ball
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.inverse.fields import Sites
from tactorch.mesh import TetMesh, box_mesh, face_nodes
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording

BALL, BACKGROUND, LUMP = 3.0, 0.03, 0.3  # mm, MPa
SIZE, HEIGHT, MARGIN = 60.0, 15.0, 8.0  # mm
CENTER, RADIUS = np.array([6.0, -4.0, -5.5]), 4.5  # mm
DEPTHS, NOISE = (0.5, 1.0, 1.5), 0.003  # mm, N
UP = np.array([0.0, 0.0, 1.0])


def block(edge: float) -> tuple[TetMesh, np.ndarray]:
    """Return the block with elements of about this size (mm), and its supports."""
    counts = [round(SIZE / edge), round(SIZE / edge), round(HEIGHT / edge)]
    center = (0.0, 0.0, -HEIGHT / 2)
    mesh = box_mesh((SIZE, SIZE, HEIGHT), counts, center_mm=center, tets_per_cell=5)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    fixed.setflags(write=False)
    return mesh, fixed


def simulated_palpation(side: int = 48, seed: int = 0) -> Recording:
    """Return a palpation at `side` x `side` places, of a known lump."""
    axis = np.linspace(MARGIN - SIZE / 2, SIZE / 2 - MARGIN, side)
    contacts = [np.array([x, y, 0.0]) for x in axis for y in axis]
    mesh, fixed = block(2.0)
    nothing = np.zeros((mesh.n_points, 3))
    body = SoftBody(mesh, make_material("linear", 0.45), element="tet10")
    places = [BallPlace(contact, UP, BALL, DEPTHS[-1]) for contact in contacts]
    sites = Sites.of(body.assembly)
    inside = (np.linalg.norm(sites.points - CENTER, axis=2) < RADIUS).mean(axis=1)
    youngs = (BACKGROUND + (LUMP - BACKGROUND) * inside).reshape(sites.shape)
    indented = Indentation(body, Supports(fixed, nothing, nothing), places).at(youngs)
    which = np.repeat(np.arange(len(places)), len(DEPTHS))
    forces = indented.press(which, np.tile(DEPTHS, len(places))).force_n
    forces += NOISE * np.random.default_rng(seed).standard_normal(len(forces))
    mesh, fixed = block(2.5)
    presses = [
        Press.by_probe(
            ProbePose(Ball(BALL), contacts[i] + (BALL - DEPTHS[k]) * UP, deviation_mm=0.02),
            mesh.n_points, force=ForceReading.along(UP, float(force), NOISE), fixed=fixed, step=k,
            direction=-UP, name=f"probe {i}",
        )
        for force, (i, k) in zip(forces, np.ndindex(len(places), len(DEPTHS)), strict=True)
    ]  # fmt: skip
    return Recording(
        mesh, tuple(presses), MaterialSpec("linear", 0.45), provenance={"simulated": True}
    )


if __name__ == "__main__":
    simulated_palpation(int(sys.argv[1])).save(sys.argv[2])
