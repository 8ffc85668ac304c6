"""A palpation by commands alone: from a table to a map, a finding and a report."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.fem.contact.pressures import ball_force
from tactorch.inverse import Reconstruction

RADIUS, NOISE = 3.0, 0.004
STIFF = np.array([8.0, 12.0])


@pytest.fixture
def palpation_file(tmp_path: Path) -> Path:
    """Forces of a half-space whose modulus is larger around one place."""
    rng = np.random.default_rng(0)
    axis = np.arange(0.0, 20.1, 4.0)
    lines = ["probe,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n"]
    for probe, (x, y) in enumerate((a, b) for a in axis for b in axis):
        near = np.exp(-((np.array([x, y]) - STIFF) ** 2).sum() / (2.0 * 3.0**2))
        for depth in np.arange(-0.6, 1.5, 0.2):
            force = 0.05 * (1.0 + near) * ball_force(np.array([depth]), RADIUS)[0]
            values = [x, y, RADIUS - depth, *(NOISE * rng.standard_normal(3))]
            values[5] += force
            lines.append(",".join([str(probe), *(f"{value:.5f}" for value in values)]))
    path = tmp_path / "palpation.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_palpation_becomes_a_map_a_finding_and_a_report(
    tactorch: Any, palpation_file: Path, tmp_path: Path
) -> None:
    recording, run = tmp_path / "p.h5", tmp_path / "run"
    done = tactorch(
        "import", "format=palpation", f"path={palpation_file}", f"out={recording}",
        f"format.radius_mm={RADIUS}", "format.depth_mm=9", "format.margin_mm=4",
        "format.edge_mm=4", "format.depths=3",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "108 presses by a probe" in done.out
    done = tactorch(
        "invert", f"recording={recording}", f"run_dir={run}",
        "initialization.start_mpa=homogeneous", "optimizer.max_iterations=4",
    )  # fmt: skip
    assert done.status == 0, done.err
    result = Reconstruction.load(run / "reconstruction.h5")
    above = result.youngs / np.median(result.youngs) - 1.0
    stiffest = result.mesh.centroids[np.argsort(-above)[:5]].mean(axis=0)
    assert np.linalg.norm(stiffest[:2] - STIFF) < 4.0
    assert len(result.predicted) == 108
    finding = json.loads((run / "finding.json").read_text())
    # A block of 9 mm is stiffer than a half-space of the plane-strain modulus 0.05 MPa.
    assert 0.02 < finding["background_mpa"] < 0.04
    lump = finding["lumps"][0]
    assert np.linalg.norm(np.array(lump["center_mm"][:2]) - STIFF) < 2.0
    assert lump["depth_90_mm"][0] < lump["depth_mm"] < lump["depth_90_mm"][1]
    assert (run / "slices.png").exists()
    done = tactorch("report", str(run))
    assert done.status == 0, done.err
    assert "Solving the presses again" not in done.out
    assert "no uncertainty" not in done.out
    page = (run / "report.html").read_text()
    assert "Presses of the largest residuals, of 108" in page
    assert ">nan<" not in page
    assert "Residual (SD)" in page
    assert "Displacement, RMS" not in page
    # Figures of displacements, of which a palpation has none, would stop the page's script.
    assert 'id="press"' not in page
    assert "no observed displacements to draw" in page
    assert "Omitted: credibility (a palpation has no observed displacements)." in page
