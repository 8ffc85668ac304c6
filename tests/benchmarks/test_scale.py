"""The scale benchmark on a mesh that takes a moment, and the breast's presses on boxes."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import box_mesh

NAME = "scale"


@pytest.fixture
def breast(benchmark: ModuleType) -> ModuleType:
    import importlib

    return importlib.import_module("breast")


@pytest.mark.parametrize("size", [1_000, 3_000, 10_000, 30_000, 100_000])
def test_sizes_are_met(benchmark: ModuleType, size: int):
    assert 5 * benchmark.cells(size) ** 3 == pytest.approx(size, rel=0.2)


@pytest.mark.slow
def test_twelve_presses_are_inverted(benchmark: ModuleType):
    recording = benchmark.record(130)
    assert len(recording.presses) == 12
    figures = benchmark.inverted(recording)
    assert figures["elements"] == recording.mesh.n_tets == 135
    assert figures["chi2"] <= 1.0
    assert 0.1 < figures["peak_gib"] < 8.0
    assert figures["products"] > figures["iterations"] > 1
    limited = benchmark.inverted(recording, max_seconds=1e-6)
    assert limited["stop_reason"] == "time limit reached"


def test_the_breast_is_left_out_with_a_reason(
    benchmark: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    rows = {size: _row(size, size / 1e4) for size in (1000, 3000)}
    monkeypatch.setenv("TACTORCH_SHARED", str(tmp_path))
    monkeypatch.setattr(benchmark, "run_size", lambda size, _: rows[size])
    benchmark.main(["--sizes", "1000", "3000", "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out.splitlines()
    assert any("DigiBreast is omitted" in line for line in printed)
    results = json.loads(printed[-1])
    assert results["breast"] is None
    assert [row["elements"] for row in results["sizes"]] == [1000, 3000]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "scale.json",
        "scale.md",
        "scale.png",
    }


def _row(size: int, seconds: float) -> dict[str, Any]:
    return {"elements": size, "seconds": seconds, "peak_gib": seconds / 10.0}


def test_fingers_push_alike_on_any_mesh(breast: ModuleType):
    totals, moments = [], []
    for divisions in ((20, 10, 3), (31, 17, 2)):
        mesh = box_mesh((200.0, 100.0, 30.0), divisions)
        forces = breast.finger_forces(mesh, (80.0, 45.0))
        loaded = np.flatnonzero(forces[:, 2])
        assert (mesh.points[loaded, 2] == 30.0).all()
        totals.append(forces.sum(axis=0))
        moments.append(forces[:, 2] @ mesh.points[:, :2])
    total = -0.5 * breast.PRESSURE * np.pi * breast.FINGER**2
    np.testing.assert_allclose(totals, [(0.0, 0.0, total)] * 2, atol=1e-12)
    np.testing.assert_allclose(moments, [(80.0 * total, 45.0 * total)] * 2, rtol=5e-3)


def test_the_plate_and_the_chest_hold(breast: ModuleType):
    mesh = box_mesh((200.0, 100.0, 30.0), (8, 4, 2))
    fixed, (x, y, z) = breast.held(mesh), mesh.points.T
    np.testing.assert_array_equal(fixed[:, 2], (z == 0.0) | (y == 0.0))
    np.testing.assert_array_equal(fixed[:, 0], y == 0.0)
    assert breast.touched(mesh, (100.0, 50.0))[(z == 30.0) & (x == 100.0) & (y == 50.0)].all()


@pytest.mark.external
def test_the_lesion_is_in_the_breast(breast: ModuleType, shared_data: Path):
    loaded = breast.Breast.load(shared_data / "digibreast")
    truth = loaded.moduli(loaded.mesh)
    assert loaded.mesh.n_tets == 65_196
    assert truth.min() == pytest.approx(breast.FAT)
    lesion = truth > 0.5 * breast.LESION
    volume = 4.0 / 3.0 * np.pi * breast.RADIUS**3
    assert loaded.mesh.volumes[lesion].sum() == pytest.approx(volume, rel=0.15)
