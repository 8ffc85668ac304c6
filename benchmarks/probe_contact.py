"""Contact of a rigid probe with a bonded layer: forces against the exact solution at small strain.

    python benchmarks/probe_contact.py [--fine] [--out FOLDER]

Balls and a flat punch are pressed without friction into a layer that is bonded to a rigid base,
four times as wide as it is thick or wider. Elements are quadratic; their edges are a third of the
contact radius there (with --fine a fifth), and at the rim of the punch an eighth of its radius.
The exact solution is that of `layer_contact.py`; on the thick layer a shallow press is close to
Hertz's. The last row is a cube of 5,000 linear elements, for the time.

The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from layer_contact import Layer, flat_punch, hertz_n, sphere
from machine import OtherWork, write_results

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact import Ball, Contact, FlatPunch, Probe
from tactorch.mesh import TetMesh, box_mesh, face_nodes, refine

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
YOUNGS_MPA = 0.2
_HEADER = (
    "| case | elements | force, N | exact, N | ratio | exact over Hertz's | steps | iterations "
    "| s |\n|" + "---|" * 9
)


@dataclass(frozen=True)
class Case:
    """A press on a layer.

    Attributes:
        name: Name.
        probe: The probe.
        depth_mm: Depth of its tip.
        thickness_mm: Thickness of the layer.
        poisson: Poisson's ratio.
        width_mm: Edge length of the layer.
    """

    name: str
    probe: Probe
    depth_mm: float
    thickness_mm: float
    poisson: float = 0.4
    width_mm: float = 40.0

    def exact(self) -> tuple[float, float, float | None]:
        """Return the force (N), the radius of the contact (mm), and the force over Hertz's."""
        layer = Layer(self.thickness_mm, YOUNGS_MPA, self.poisson)
        if isinstance(self.probe, FlatPunch):
            pressed = flat_punch(layer, self.probe.radius_mm, self.depth_mm)
            return pressed.force_n, self.probe.radius_mm, None
        assert isinstance(self.probe, Ball)
        pressed = sphere(layer, self.probe.radius_mm, self.depth_mm)
        over_hertz = pressed.force_n / hertz_n(layer, self.probe.radius_mm, self.depth_mm)
        return pressed.force_n, pressed.radius_mm, over_hertz


CASES = (
    Case("ball, thick layer, shallow", Ball(3.0), 0.05, 10.0),
    Case("ball, thick layer", Ball(3.0), 0.2, 10.0),
    Case("ball, thin layer", Ball(3.0), 0.1, 2.0, width_mm=20.0),
    Case("ball, thin layer, nu 0.49", Ball(3.0), 0.1, 2.0, poisson=0.49, width_mm=20.0),
    Case("flat punch, thick layer", FlatPunch(2.0), 0.1, 10.0),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fine", action="store_true", help="smaller elements")
    parser.add_argument("--out", type=Path, help="folder for probe_contact.json and .md")
    options = parser.parse_args(arguments)
    meter, lines, results = OtherWork(), [_HEADER], {}
    print(_HEADER, flush=True)
    for case in CASES:
        results[case.name] = run(case, 5.0 if options.fine else 3.0)
        lines.append(_row(case.name, results[case.name]))
        print(lines[-1], flush=True)
    results["cube of linear elements"] = timed()
    lines.append(_row("cube of linear elements", results["cube of linear elements"]))
    print(lines[-1])
    result = {"cases": results, "fine": options.fine, "other_work": meter.share()}
    if options.out is not None:
        write_results(options.out, "probe_contact", lines, result, PACKAGES)
    print(json.dumps(result))


def run(case: Case, per_radius: float = 3.0) -> dict[str, Any]:
    """Press the probe of a case and compare the force.

    Args:
        case: The case.
        per_radius: Radius of the contact over the edges of the elements there.
    """
    exact, radius, over_hertz = case.exact()
    mesh = make_mesh(case, radius, per_radius)
    found = press(mesh, case.probe, case.depth_mm, case.poisson, "tet10")
    return {**found, "exact_n": exact, "ratio": found["force_n"] / exact, "over_hertz": over_hertz}


def make_mesh(case: Case, radius_mm: float, per_radius: float) -> TetMesh:
    """Return the layer with small elements at the contact."""
    cells = 6
    grid = box_mesh(case.thickness_mm, cells, tets_per_cell=5)
    wide = grid.points.copy()
    wide[:, :2] *= case.width_mm / case.thickness_mm
    middle = np.array([case.width_mm / 2, case.width_mm / 2, case.thickness_mm])
    sharp = isinstance(case.probe, FlatPunch)

    def sizing(points: np.ndarray) -> np.ndarray:
        offsets = points - middle
        across = np.hypot(*offsets[:, :2].T)
        rim = np.hypot(across - radius_mm if sharp else np.maximum(across - radius_mm, 0.0),
                       offsets[:, 2])  # fmt: skip
        return radius_mm / (8.0 if sharp else per_radius) + 0.7 * rim

    return refine(TetMesh.create(wide, grid.tets, repair=False), sizing).mesh


def timed() -> dict[str, Any]:
    """Press a ball into a cube of about 5,000 linear elements, the second time for the time."""
    mesh = box_mesh(10.0, 10, tets_per_cell=5)
    press(mesh, Ball(4.0), 0.5, 0.45, "tet4")
    return press(mesh, Ball(4.0), 0.5, 0.45, "tet4")


def press(
    mesh: TetMesh, probe: Probe, depth_mm: float, poisson: float, element: str
) -> dict[str, Any]:
    """Press a probe into the middle of the top of a block that is bonded at the bottom."""
    began = time.perf_counter()
    body = SoftBody(mesh, make_material("neo_hookean", poisson), element=element)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    high = mesh.points.max(axis=0)
    tip = np.array([high[0] / 2, high[1] / 2, high[2] - depth_mm])
    if isinstance(probe, Ball):
        tip[2] += probe.radius_mm
    contact = Contact.of(body.discretisation, probe, tip, YOUNGS_MPA)
    uniform, nothing = np.full(mesh.n_tets, YOUNGS_MPA), np.zeros((mesh.n_points, 3))
    result = body.equilibrate(uniform, nothing, Supports(fixed=fixed), contact=contact).require()
    return {
        "elements": mesh.n_tets,
        "force_n": float(contact.at(result.displacement).force_n[2]),
        "steps": result.load_steps,
        "iterations": result.iterations,
        "seconds": time.perf_counter() - began,
    }


def _row(name: str, found: dict[str, Any]) -> str:
    cells = [name, str(found["elements"]), f"{found['force_n']:.4g}"]
    for key, digits in (("exact_n", ".4g"), ("ratio", ".3f"), ("over_hertz", ".3f")):
        value = found.get(key)
        cells.append("-" if value is None else f"{value:{digits}}")
    cells += [str(found["steps"]), str(found["iterations"]), f"{found['seconds']:.1f}"]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
