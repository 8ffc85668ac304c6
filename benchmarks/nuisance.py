"""Wrong assumptions and their joint estimation (Section V-C2, Fig. 9, and beyond).

    python benchmarks/nuisance.py [--only CASE ...] [--snr-db 40] [--out FOLDER]

The shallow cube of Table II (10 mm, 0.2 MPa, a ball of 1 MPa; Poisson's ratio 0.45) pressed from
three sides in four steps up to 20 kPa, with white noise; once simulated on the mesh that it is
inverted on, as in the paper (inverse crime), and once on a mesh twice as fine. Each case is
inverted three times:

- `right`: with correct assumptions; only the map is estimated;
- `wrong`: with a wrong assumption; only the map is estimated, as in Fig. 9 of the paper;
- `joint`: with the same wrong assumption, the nuisance parameter estimated with the map; its prior
  deviation is the size of the errors studied here: 0.02 in Poisson's ratio, 20 % in force, 10 % in
  size.

A case passes if the error of `joint` is at most twice that of `right`. A wrong size is relative to
the support of the object, so that the displacements contain the difference of the shapes. The last
line printed is one JSON object with all figures.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, describe_machine

from tactorch.inverse import NuisancePrior, Reconstruction, Settings, invert_map
from tactorch.metrics import scores
from tactorch.phantoms import make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.simulation import PressPlan, perturb_recording, simulate

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
DEVIATIONS = {"poisson": 0.02, "force_scale": 0.2, "rest_scale": 0.1}
MESHES = ("same", "other")


@dataclass(frozen=True)
class Case:
    """A wrong assumption, and the nuisance parameters that may explain it."""

    assumptions: dict[str, Any]
    free: tuple[str, ...] = field(default=())


CASES = {
    "poisson +0.02": Case({"poisson": 0.02}, ("poisson",)),
    "poisson -0.02": Case({"poisson": -0.02}, ("poisson",)),
    "force x1.2": Case({"force_scale": 1.2}, ("force_scale",)),
    "force x0.8": Case({"force_scale": 0.8}, ("force_scale",)),
    "size x1.1": Case({"size": 1.1}, ("rest_scale",)),
    "size x0.9": Case({"size": 0.9}, ("rest_scale",)),
    "height x1.1": Case({"size": (1.0, 1.0, 1.1)}, ("rest_scale",)),
    "all": Case(
        {"poisson": 0.02, "force_scale": 1.2, "size": 1.1},
        ("poisson", "force_scale", "rest_scale"),
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--snr-db", type=float, default=40.0)
    parser.add_argument("--edge", type=float, default=0.1, help="mesh size, relative")
    parser.add_argument("--out", type=Path, help="folder for nuisance.json and .md")
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    options = parser.parse_args(arguments)
    meter, lines, results = OtherWork(), [], {}
    for mesh in options.meshes:
        recording = record(options.snr_db, options.edge, same_mesh=mesh == "same")
        results[mesh] = study(recording, options.only, f"{mesh} mesh", lines)
    print(f"\nOther processes took {meter.share() or 0:.0%} of the cores meanwhile.")
    if options.out is not None:
        _write(options.out, lines, results)
    print(json.dumps(results))


def study(recording: Recording, names: list[str], title: str, lines: list[str]) -> dict[str, Any]:
    """Run the cases on one recording; the table's lines are printed and kept."""

    def say(line: str) -> None:
        lines.append(line)
        print(line, flush=True)

    right = judge(recording, recording, ())
    say(f"\n{title}\n{_header()}")
    say(_row("right assumptions", right))
    cases: dict[str, Any] = {}
    for name in names:
        case = CASES[name]
        seen = perturb_recording(recording, **case.assumptions)
        cases[name] = {}
        for kind, free in (("wrong", ()), ("joint", case.free)):
            found = judge(recording, seen, free)
            found["over_right"] = found["rmse_log"] / right["rmse_log"]
            cases[name][kind] = found
            say(_row(f"{name}, {kind}", found))
    return {"right": right, "cases": cases}


def record(snr_db: float, edge: float = 0.1, *, same_mesh: bool) -> Recording:
    """Press the cube."""
    phantom = make_phantom("cube_shallow_sphere")
    return simulate(
        phantom,
        PressPlan(faces=("z+", "x+", "y+"), p_max_mpa=0.02, steps=4),
        material=MaterialSpec("neo_hookean", 0.45),
        mesh=phantom.mesh(relative_edge_length=edge),
        fine_mesh=None if same_mesh else phantom.mesh(relative_edge_length=edge / 2),
        samples=1 if same_mesh else 4,
        snr_db=snr_db,
        seed=0,
    )


def judge(true: Recording, seen: Recording, free: tuple[str, ...]) -> dict[str, Any]:
    """Invert what was seen and compare with the truth, element by element on the true shape."""
    truth = true.truth
    assert truth is not None
    settings = Settings(nuisance=NuisancePrior(**{name: DEVIATIONS[name] for name in free}))
    found = invert_map(replace(seen, truth=None, check_units=False), settings, show_progress=False)
    own = scores(true.mesh, found.youngs, truth)
    share = true.mesh.volumes / true.mesh.volumes.sum()
    log_error = np.log(found.youngs / truth)
    return {
        "rmse_mpa": own["rmse_mpa"],
        "rmse_log": float(np.sqrt(share @ log_error**2)),
        "bias": float(np.exp(share @ log_error)),
        "ssim": own["ssim"],
        "pearson": own["pearson"],
        "position_error_mm": own["position_error_mm"],
        "chi2": found.history[-1]["chi2"],
        "seconds": found.seconds,
        "iterations": found.iterations,
        "estimates": _estimates(found),
    }


def _estimates(found: Reconstruction) -> dict[str, Any]:
    return {name: estimate.plain() for name, estimate in found.nuisance.items()}


def _header() -> str:
    return (
        f"{'case':24} {'RMSE MPa':>9} {'RMSE log E':>11} {'/right':>7} {'E/truth':>8} "
        f"{'SSIM':>6} {'r':>6} {'chi2':>9} {'s':>6}  estimates (deviation)"
    )


def _row(name: str, found: dict[str, Any]) -> str:
    estimates = "  ".join(
        f"{key} "
        + ", ".join(f"{v:.4f} ({d:.4f})" for v, d in zip(e["value"], e["deviation"], strict=True))
        for key, e in found["estimates"].items()
    )
    return (
        f"{name:24} {found['rmse_mpa']:9.4f} {found['rmse_log']:11.4f} "
        f"{found.get('over_right', 1.0):7.2f} {found['bias']:8.3f} "
        f"{found['ssim']:6.3f} {found['pearson']:6.3f} {found['chi2']:9.3g} "
        f"{found['seconds']:6.1f}  {estimates}"
    )


def _write(folder: Path, lines: list[str], results: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    machine = describe_machine(PACKAGES)
    (folder / "nuisance.json").write_text(json.dumps({"machine": machine, **results}, indent=1))
    table = "\n".join(lines)
    (folder / "nuisance.md").write_text(f"# Nuisance parameters\n\n```\n{table}\n```\n")


if __name__ == "__main__":
    main()
