"""From a labelled volume to a map by commands alone."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import read_mesh
from tactorch.recording import Recording


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    values = np.zeros((7, 7, 6), dtype=np.int16)
    values[1:-1, 1:-1, 1:-1] = 1
    values[2:5, 2:5, 2:4] = 2
    path = tmp_path / "labels.npz"
    np.savez(path, labels=values, spacing_mm=[2.0, 2.0, 2.0])
    return path


def test_a_volume_becomes_a_body_with_regions(tactorch: Any, labels: Path, tmp_path: Path) -> None:
    out = tmp_path / "body.vtu"
    done = tactorch(
        "body", f"volume={labels}", f"out={out}", "edge_length_mm=4",
        "labels={1: tissue, 2: nodule}",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "2 (nodule)" in done.out
    assert "144" in done.out
    mesh = read_mesh(out)
    assert set(mesh.regions) == {1, 2}
    assert mesh.volumes.sum() == pytest.approx(800.0, rel=0.02)


@pytest.mark.slow
def test_a_volume_is_simulated_and_inverted_by_region(
    tactorch: Any, labels: Path, tmp_path: Path
) -> None:
    recording, run = tmp_path / "r.h5", tmp_path / "run"
    done = tactorch(
        "simulate", "phantom=labelled", f"phantom.volume={labels}",
        "phantom.region_mpa={1: 0.1, 2: 0.4}", "press=top", "press.support=fixed",
        "press.p_max_mpa=0.01", "press.steps=1", "mesh=same", "mesh.edge_length_mm=4",
        f"out={recording}",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert set(Recording.load(recording).mesh.regions) == {1, 2}
    done = tactorch(
        "invert", f"recording={recording}", f"run_dir={run}", "initialization=regions",
        "regularization=tikhonov", "regularization.region_mpa={1: 0.1, 2: 0.4}", "method=map",
        "plots=false", "optimizer.max_iterations=3",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "Region 2: median" in done.out
    regions = json.loads((run / "summary.json").read_text())["regions"]
    assert regions["1"]["median_mpa"] == pytest.approx(0.1, rel=0.2)
    assert regions["2"]["median_mpa"] == pytest.approx(0.4, rel=0.4)
    assert read_mesh(run / "reconstruction.vtu").regions is not None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["out=body.stl"], "ends in .vtu or .msh"),
        (["labels=[5]"], "no label 5; its labels are 1, 2"),
        (["edge_length_mm=0.1"], "below the voxels"),
        (["labels={1: tissue", "keep_largest=maybe"], "labels"),
        (["volume=none.nii.gz"], "not found"),
    ],
)
def test_wrong_input_is_one_message(
    tactorch: Any, labels: Path, changes: list[str], message: str
) -> None:
    given = {"volume": labels, "out": "body.vtu"}
    given |= dict(change.split("=", 1) for change in changes)
    done = tactorch("body", *(f"{key}={value}" for key, value in given.items()))
    assert done.status != 0
    assert message in done.err
    assert "Traceback" not in done.err
    assert not list(Path().glob("*.vtu"))
