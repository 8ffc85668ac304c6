"""Palpation tables: contacts by the forces, block below them, and errors of wrong files."""

import logging
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import FileError, TactorchError
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers import import_palpation
from tactorch.importers.contacts import unevenness
from tactorch.recording import Recording

RADIUS, MODULUS, NOISE = 3.0, 0.05, 0.01
COLUMNS = ("probe", "x_mm", "y_mm", "z_mm", "fx_n", "fy_n", "fz_n")
CONTACTS = (
    "contact_x_mm", "contact_y_mm", "contact_z_mm", "normal_x", "normal_y", "normal_z",
)  # fmt: skip


def height(xy: np.ndarray) -> np.ndarray:
    return 0.02 * xy[:, 0] + 0.5 * np.sin(xy[:, 1] / 8.0) - 40.0


def table(
    early_mm: float = 0.4, offset_n: float = 0.0, seed: int = 0, contacts: bool = True
) -> tuple[tuple[str, ...], np.ndarray]:
    """A ball that is pressed into a half-space; samples begin `early_mm` above the surface."""
    rng = np.random.default_rng(seed)
    axis = np.arange(0.0, 25.0, 4.0)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    rows = []
    for probe, place in enumerate(xy):
        z = float(height(place[None])[0])
        for depth in np.arange(0.0, 2.0, 0.2) - early_mm:
            force = MODULUS * ball_force(np.array([depth]), RADIUS)[0] + offset_n
            sample = [probe, *place, z + RADIUS - depth, *(NOISE * rng.standard_normal(3))]
            sample[6] += force
            rows.append([*sample, *place, z, 0.0, 0.0, 1.0] if contacts else sample)
    return (*COLUMNS, *(CONTACTS if contacts else ())), np.array(rows)


def write(path: Path, names: tuple[str, ...], rows: np.ndarray) -> Path:
    lines = [",".join(names), *(",".join(f"{v:.6f}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_contacts_are_found_by_the_forces(tmp_path: Path) -> None:
    recording = import_palpation(write(tmp_path / "p.csv", *table(early_mm=-0.3)), radius_mm=RADIUS)
    assert len(recording.presses) == 49 * 4
    assert recording.material.name == "linear"
    depths = []
    for press in recording.presses:
        assert press.probe is not None
        assert press.force is not None
        lowest = press.probe.position_mm - [0.0, 0.0, RADIUS]
        depths.append(height(lowest[None, :2])[0] - lowest[2])
    forces = np.array([press.force.values[0] for press in recording.presses])
    assert np.median(np.abs(forces - MODULUS * ball_force(np.array(depths), RADIUS))) < 2 * NOISE
    assert recording.provenance["noise_n"] == pytest.approx(NOISE, rel=0.4)


def test_depths_are_less_certain_at_a_step_of_the_surface() -> None:
    axis = np.arange(0.0, 41.0, 2.0)
    x, y = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2).T
    smooth = 0.3 * x - 0.01 * y**2
    assert unevenness(np.column_stack([x, y, smooth])).max() < 0.01
    step = np.column_stack([x, y, smooth + 1.0 * (x > 20.0)])
    deviations = unevenness(step)
    assert deviations[np.abs(x - 21.0) < 2.0].min() > 0.15
    assert deviations[np.abs(x - 21.0) > 10.0].max() < 0.01
    assert not unevenness(step[:10]).any()


def test_the_surface_and_the_block_are_where_the_contacts_are(tmp_path: Path) -> None:
    path = write(tmp_path / "p.csv", *table())
    recording = import_palpation(path, radius_mm=RADIUS, depth_mm=10.0, margin_mm=5.0)
    low, high = recording.mesh.bounds
    assert low[:2] == pytest.approx([-5.0, -5.0])
    assert high[:2] == pytest.approx([29.0, 29.0])
    surface = recording.mesh.points[recording.mesh.points[:, 2] > low[2] + 5.0]
    top = surface[np.abs(surface[:, 2] - height(surface[:, :2])) < 0.3]
    assert len(top) >= 100
    assert height(top[:, :2]).min() - low[2] == pytest.approx(10.0, abs=0.5)
    assert recording.presses[0].fixed[recording.mesh.points[:, 2] < low[2] + 1e-6].all()


def test_a_block_of_unknown_depth_is_deep_for_the_ball(tmp_path: Path) -> None:
    path = write(tmp_path / "p.csv", *table())
    recording = import_palpation(path, radius_mm=RADIUS)
    top, (low, _) = recording.mesh.points[:, 2].max(), recording.mesh.bounds
    assert 5.0 * RADIUS < top - low[2] < 5.0 * RADIUS + 4.0  # the surface is not flat
    assert recording.provenance["depth_mm"] is None


def test_samples_clear_of_the_surface_tell_the_offset(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "p.csv", *table(early_mm=0.6, offset_n=0.05))
    recording = import_palpation(path, radius_mm=RADIUS)
    assert recording.provenance["tare_n"] == pytest.approx(0.05, abs=0.005)
    assert "offset" not in caplog.text
    pressed = write(tmp_path / "q.csv", *table(early_mm=-0.3))
    with caplog.at_level(logging.WARNING):
        assert import_palpation(pressed, radius_mm=RADIUS).provenance["tare_n"] == 0.0
    assert "offset of the force sensor is taken as zero" in caplog.text


def test_the_radius_is_that_of_the_contacts_and_normals_are_those_of_the_motion(
    tmp_path: Path,
) -> None:
    names, rows = table(early_mm=0.0)
    recording = import_palpation(write(tmp_path / "p.csv", names, rows))
    assert recording.provenance["ball_radius_mm"] == pytest.approx(RADIUS)
    bare = import_palpation(
        write(tmp_path / "q.csv", *table(early_mm=0.0, contacts=False)), radius_mm=RADIUS
    )
    for one, other in zip(recording.presses, bare.presses, strict=True):
        assert one.probe.position_mm == pytest.approx(other.probe.position_mm, abs=1e-6)


def test_all_samples_in_contact_are_kept_on_demand_and_a_file_round_trips(tmp_path: Path) -> None:
    path = write(tmp_path / "p.csv", *table())
    recording = import_palpation(path, radius_mm=RADIUS, depths=None)
    # Of ten samples of a probe, the first two are in air, and the third is at the surface.
    assert 49 * 7 <= len(recording.presses) <= 49 * 8
    recording.save(tmp_path / "p.h5")
    loaded = Recording.load(tmp_path / "p.h5")
    last, same = recording.presses[-1], loaded.presses[-1]
    assert same.probe.position_mm == pytest.approx(last.probe.position_mm)
    assert 0.1 < same.probe.deviation_mm < 0.15  # more where contacts are not on a smooth surface
    assert same.fixed is loaded.presses[0].fixed
    assert np.isnan(same.displacement).all()
    assert not same.forces.any()


def test_averages_are_as_certain_as_many_samples(tmp_path: Path) -> None:
    path = write(tmp_path / "p.csv", *table(early_mm=-0.1))
    one = import_palpation(path, radius_mm=RADIUS, depths=1, noise_n=0.01).presses[0]
    assert one.force.deviations == pytest.approx([0.01 / np.sqrt(10.0)])


def test_a_given_mesh_is_used(tmp_path: Path) -> None:
    from tactorch.mesh import box_mesh, write_mesh

    mesh = box_mesh((40.0, 40.0, 12.0), (8, 8, 3), origin_mm=(-8.0, -8.0, -52.0))
    mesh = mesh.with_regions((mesh.centroids[:, 2] > -46.0) + 1)
    write_mesh(tmp_path / "body.vtu", mesh)
    path = write(tmp_path / "p.csv", *table())
    recording = import_palpation(path, radius_mm=RADIUS, mesh=tmp_path / "body.vtu")
    assert recording.mesh.n_tets == mesh.n_tets
    np.testing.assert_array_equal(recording.mesh.regions, mesh.regions)
    assert recording.presses[0].fixed[:, 2].sum() == 81


def test_faulty_probes_and_rows_are_left_out_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    names, rows = table()
    kept = ~((rows[:, 0] == 5) & (np.arange(len(rows)) % 10 > 1))  # too few samples
    rows[rows[:, 0] == 7, 1:4] = rows[70, 1:4]  # no motion
    rows[rows[:, 0] == 9, 6] = 0.0  # no force
    rows[rows[:, 0] == 11, -1] = -1.0  # a normal into the object
    rows[133, 6] += 3.0  # an outlier of probe 13
    rows[150, 2] = np.nan
    with caplog.at_level(logging.WARNING):
        recording = import_palpation(
            write(tmp_path / "p.csv", names, rows[kept]), radius_mm=RADIUS, depths=None
        )
    used = {press.name for press in recording.presses}
    assert used == {f"probe {n}" for n in range(49)} - {f"probe {n}" for n in (5, 7, 9, 11)}
    for text in (
        "samples while the ball is pressed in: '5'",
        "travel",
        "does not rise",
        "upwards",
        "of probes 13",
    ):
        assert text in caplog.text
    assert 6 <= sum(press.name == "probe 13" for press in recording.presses) <= 7  # in contact
    assert "1 rows without a number" in caplog.text


BAD = {
    "missing column": (lambda n, r: ((*n[:3], "height", *n[4:]), r), "lacks the column 'z_mm'"),
    "metres": (
        lambda n, r: (n, _scaled(r, slice(1, 4), 1e-3)),
        "in m; give .format.units={x: m, y: m, z: m, contact_x: m",
    ),
    "millinewtons": (
        lambda n, r: (n, _scaled(r, slice(4, 7), 1e5)),
        "in mN; give .format.units={fx: mN, fy: mN, fz: mN}",
    ),
    "force that pulls": (lambda n, r: (n, _scaled(r, slice(4, 7), -1.0)), "force rises"),
    "z downwards": (lambda n, r: (n, _scaled(r, slice(12, 13), -1.0)), "z upwards"),
    "too few samples": (lambda n, r: (n, r[::5]), "no probe that can be used"),
    "one probe": (lambda n, r: (n, r[:10]), r"at least 3 .*give the object as format\.mesh"),
    "probes in line": (lambda n, r: (n, r[r[:, 1] == 0.0]), r"in line.*format\.mesh"),
    "a name twice": (lambda n, r: ((*n[:2], "x_mm", *n[3:]), r), "lacks|two columns"),
}


def _scaled(rows: np.ndarray, columns: slice, factor: float) -> np.ndarray:
    rows = rows.copy()
    rows[:, columns] *= factor
    return rows


@pytest.mark.parametrize("fault", BAD)
def test_wrong_files_are_refused(tmp_path: Path, fault: str) -> None:
    change, message = BAD[fault]
    path = write(tmp_path / "p.csv", *change(*table()))
    with pytest.raises(TactorchError, match=message):
        import_palpation(path, radius_mm=RADIUS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        (",".join(COLUMNS) + "\n", "has no rows"),
        (",".join(COLUMNS) + "\n0,1,2\n", "line 2 has 3 cells"),
        (",".join(COLUMNS) + "\n0,1,2,x,0,0,1\n", "column 'z_mm', has 'x'"),
        (",".join((*COLUMNS, "x_mm")) + "\n0,1,2,3,0,0,1,1\n", "two columns 'x_mm'"),
    ],
)
def test_broken_text_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        import_palpation(path, radius_mm=RADIUS)


def test_a_missing_or_binary_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="palpation"):
        import_palpation(tmp_path / "none.csv", radius_mm=RADIUS)
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00probe")
    with pytest.raises(FileError, match="not a table"):
        import_palpation(tmp_path / "b.csv", radius_mm=RADIUS)


def test_a_file_without_contacts_needs_the_radius(tmp_path: Path) -> None:
    path = write(tmp_path / "p.csv", *table(contacts=False))
    with pytest.raises(FileError, match=r"format\.radius_mm"):
        import_palpation(path)
