"""Tables of recordings, and their way back through files."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, RecordingError
from tactorch.fem.contact import Ball
from tactorch.importers import import_table
from tactorch.mesh import box_mesh, write_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import ForceReading, Press, ProbePose, Recording, SurfaceReading
from tactorch.simulation import PressPlan, simulate

pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Two load steps on springs, with readings along a direction at a node and elsewhere."""
    made = simulate(
        make_phantom("cube_sphere", radius=0.3),
        PressPlan(("z+",), (0.01, 0.02)),
        mesh=box_mesh(10.0, 2, tets_per_cell=5),
        samples=1,
        snr_db=40,
    )
    points = np.array([(5.0, 5.0, 10.0), (2.5, 3.5, 10.0)])
    directions = np.array([(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
    reading = SurfaceReading(points, directions, np.array([-0.3, -0.2]), np.array([0.01, 0.02]))
    first, second = made.presses
    fixed = np.zeros((made.mesh.n_points, 3), dtype=bool)
    fixed[made.mesh.points[:, 2] < 0.1, :2] = True
    presses = (first, replace(second, surface=reading, fixed=fixed))
    return replace(made, presses=presses, check_units=False)


def test_rows_are_presses_and_nodes(recording: Recording) -> None:
    frame = recording.to_frame()
    nodes = recording.mesh.surface.nodes()
    assert len(frame) == 2 * len(nodes) + 2
    second = frame[(frame.press == recording.presses[1].name) & frame.node.notna()]
    press = recording.presses[1]
    np.testing.assert_array_equal(second.node.to_numpy(dtype=int), nodes)
    np.testing.assert_array_equal(second[["ux_mm", "uy_mm", "uz_mm"]], press.displacement[nodes])
    np.testing.assert_array_equal(second[["fx_n", "fy_n", "fz_n"]], press.forces[nodes])
    np.testing.assert_array_equal(second.spring_z_n_per_mm, press.springs[nodes, 2])
    assert (second.noise_mm == press.noise_mm).all()
    assert (second.step == 1).all()
    assert frame.attrs["poisson"] == recording.material.poisson
    assert len(recording.to_frame(interior=True)) == 2 * recording.mesh.n_points + 2


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_file_of_the_table_gives_the_recording_back(
    recording: Recording, tmp_path: Path, suffix: str
) -> None:
    write_mesh(tmp_path / "body.vtu", recording.mesh)
    frame, path = recording.to_frame(interior=True), tmp_path / f"presses.{suffix}"
    if suffix == "csv":
        frame.to_csv(path, index=False)
    else:
        pytest.importorskip("pyarrow")
        frame.to_parquet(path)
    back = import_table(
        path, mesh=tmp_path / "body.vtu", material=recording.material.name,
        poisson=recording.material.poisson,
    )  # fmt: skip
    assert back.mesh.content_hash() == recording.mesh.content_hash()
    for made, press in zip(back.presses, recording.presses, strict=True):
        for field in ("forces", "observed", "displacement", "springs", "fixed", "noise_mm"):
            np.testing.assert_array_equal(getattr(made, field), getattr(press, field))
        assert (made.name, made.step) == (press.name, press.step)
    reading, expected = back.presses[1].surface, recording.presses[1].surface
    assert back.presses[0].surface is None
    assert reading is not None
    assert expected is not None
    for name, values in vars(expected).items():
        np.testing.assert_allclose(getattr(reading, name), values, atol=1e-12)
    again = back.to_frame(interior=True)
    assert list(again.columns) == list(frame.columns)


def test_repeated_and_empty_names_get_numbers(recording: Recording) -> None:
    first = recording.presses[0]
    three = (replace(first, name="a"), replace(first, name="a"), replace(first, name=""))
    frame = replace(recording, presses=three, check_units=False).to_frame()
    assert list(frame.press.unique()) == ["a 0", "a 1", "2"]
    assert "u_n_mm" not in frame


def test_presses_by_probes_are_refused(recording: Recording) -> None:
    pose = ProbePose(Ball(2.0), np.array([5.0, 5.0, 11.5]))
    force = ForceReading.along((0, 0, 1), 0.1, 0.01)
    fixed = recording.mesh.points[:, [2, 2, 2]] < 0.1
    press = Press.by_probe(pose, recording.mesh.n_points, force=force, fixed=fixed, name="ball")
    with pytest.raises(RecordingError, match=r"press 'ball' is by a probe.*select"):
        replace(recording, presses=(press,), check_units=False).to_frame()


def test_without_pandas_the_extra_is_named(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigError, match=r"tactorch\[tables\]"):
        recording.to_frame()


def test_data_that_the_table_does_not_hold_are_refused(recording: Recording) -> None:
    press = recording.presses[1]
    prescribed = np.where(press.fixed, 0.1, 0.0)
    moved = replace(recording, presses=(replace(press, prescribed=prescribed),))
    with pytest.raises(RecordingError, match="has prescribed displacements"):
        moved.to_frame()
    inside = np.ones(recording.mesh.n_points, dtype=bool)
    inside[recording.mesh.surface.nodes()] = False
    held = press.fixed | (inside[:, None] & (np.arange(3) == 2))
    if not inside.any():
        pytest.fail("the mesh has no interior node")
    deep = replace(recording, presses=(replace(press, fixed=held, prescribed=0.0 * prescribed),))
    with pytest.raises(RecordingError, match=r"fixed at interior nodes.*interior=True"):
        deep.to_frame()
    assert len(deep.to_frame(interior=True)) == recording.mesh.n_points + 2
