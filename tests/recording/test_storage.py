from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tactorch.errors import FileError, RecordingError
from tactorch.fem.contact import Ball
from tactorch.mesh import box_mesh
from tactorch.recording import (
    ForceReading,
    MaterialSpec,
    Press,
    ProbePose,
    Recording,
    SurfaceReading,
    append_press,
    compact,
    read_presses,
)
from tactorch.recording.append import digest

Make = Callable[..., Recording]
ARRAYS = ("forces", "observed", "displacement", "springs", "fixed", "prescribed")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=6,
)


def numbers(shape: Any, low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, shape, elements=st.floats(low, high))


# The strategies draw plain values only: the type checker that watches the classes draws random
# numbers of its own, which Hypothesis does not want to see while it draws.
@st.composite
def presses(draw: st.DrawFn, n: int) -> dict[str, Any]:
    """Draw what Press(**fields) takes."""
    observed = draw(hnp.arrays(np.bool_, (n, 3)))
    fixed = draw(hnp.arrays(np.bool_, (n, 3)))
    fixed[0], observed[0] = False, True
    forces = draw(numbers((n, 3), -5, 5))
    forces[0, 0] = 1.0
    return {
        "forces": forces,
        "observed": observed,
        "displacement": draw(numbers((n, 3), -5, 5)),
        "springs": draw(numbers((n, 3), 0.01, 10)),
        "fixed": fixed,
        "prescribed": np.where(fixed, draw(numbers((n, 3), -1, 1)), 0.0),
        "noise_mm": draw(st.none() | st.floats(0, 1)),
        "weights": draw(st.none() | numbers((n, 3), 1e-3, 10)),
        "step": draw(st.integers(0, 1000)),
        "direction": draw(st.none() | st.sampled_from(list(np.eye(3)))),
        # HDF5 text ends at a NUL, and half a surrogate pair is no text.
        "name": draw(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))),
    }


def frames(nodes: int) -> st.SearchStrategy[np.ndarray]:
    """Draw two frames without contact, the last node unseen."""

    def shaped(values: np.ndarray) -> np.ndarray:
        found = values.reshape(2, nodes, 3)
        found[:, -1] = np.nan
        return found

    return numbers(6 * nodes, -1e-2, 1e-2).map(shaped)


@st.composite
def recordings(draw: st.DrawFn) -> dict[str, Any]:
    """Draw what Recording(**fields) takes, with parts for mesh, presses and material."""
    cells = draw(st.integers(1, 2))
    moduli = numbers(6 * cells, 1e-3, 10)
    return {
        "mesh": ((draw(st.floats(1, 100)),) * 3, (1, 1, cells)),
        "presses": draw(st.lists(presses(4 * cells + 4), min_size=1, max_size=3)),
        "material": ("law", draw(st.floats(0, 0.49)), {"a": draw(st.floats(-1, 1))}),
        "truth": draw(st.none() | moduli),
        "reference": draw(st.none() | moduli),
        "provenance": draw(st.dictionaries(st.text(max_size=5), JSON, max_size=3)),
        "density": 1e-9,
        "gravity": draw(numbers(3, -1e4, 1e4)),
        "unloaded": draw(st.none() | frames(4 * cells + 4)),
    }


def build(parts: dict[str, Any]) -> Recording:
    return Recording(
        **{
            **parts,
            "mesh": box_mesh(*parts["mesh"]),
            "presses": tuple(Press(**fields) for fields in parts["presses"]),
            "material": MaterialSpec(*parts["material"]),
        },
        check_units=False,
    )


def same(a: np.ndarray | None, b: np.ndarray | None) -> None:
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


@settings(max_examples=15)
@given(recordings())
def test_round_trip_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory, parts: dict[str, Any]
) -> None:
    recording = build(parts)
    path = tmp_path_factory.mktemp("trip") / "recording.h5"
    recording.save(path)
    loaded = Recording.load(path, check_units=False)
    assert loaded.mesh.content_hash() == recording.mesh.content_hash()
    assert loaded.material == recording.material
    assert loaded.provenance == recording.provenance
    assert loaded.density == recording.density
    for name in ("truth", "reference", "gravity", "unloaded"):
        same(getattr(loaded, name), getattr(recording, name))
    assert len(loaded.presses) == len(recording.presses)
    for one, other in zip(loaded.presses, recording.presses, strict=True):
        for name in (*ARRAYS, "weights", "direction"):
            same(getattr(one, name), getattr(other, name))
        assert (one.name, one.step, one.noise_mm) == (other.name, other.step, other.noise_mm)


def test_the_first_version_is_still_read(saved: Path) -> None:
    with h5py.File(saved, "r+") as file:
        del file["provenance"].attrs["sha256"]
        file.attrs["version"] = 1
    assert Recording.load(saved).unloaded is None


@pytest.fixture
def saved(record: Make, tmp_path: Path) -> Path:
    path = tmp_path / "case.h5"
    record({"noise_mm": 0.01}, truth=np.full(48, 0.2)).save(path)
    return path


def test_absent_density_stays_absent(saved: Path) -> None:
    assert Recording.load(saved).density is None


def test_file_is_as_documented(saved: Path) -> None:
    with h5py.File(saved) as file:
        assert dict(file.attrs) == {
            "format": b"tactorch-recording",
            "version": 6,
            "units": b"mm, N, MPa, tonne/mm^3",
        }
        assert set(file) == {"mesh", "material", "gravity", "provenance", "truth", "presses"}
        press = file["presses/0000"]
        assert set(press) == set(ARRAYS)
        assert press["observed"].dtype == np.uint8
        assert press["forces"].dtype == np.float64
        assert file["mesh/tets"].dtype == np.int64
        assert press["springs"].compression == "gzip"


def test_failed_save_leaves_the_old_file(
    saved: Path, record: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = saved.read_bytes()

    def full(*_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(FileError, match=r"cannot write '.*case\.h5': No space"):
        record().save(saved)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == ["case.h5"]


def test_refuses_text_that_hdf5_cannot_hold(record: Make, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="NUL"):
        record({"name": "a\0"}).save(tmp_path / "case.h5")
    assert not list(tmp_path.iterdir())


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"recording not found: '.*none\.h5'"):
        Recording.load(tmp_path / "none.h5")


@pytest.mark.parametrize("content", [b"", b"point data\n1 2 3\n"])
def test_other_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "case.h5"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"case\.h5' is not an HDF5 file"):
        Recording.load(path)


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_truncated_files(saved: Path, part: float) -> None:
    content = saved.read_bytes()
    saved.write_bytes(content[: int(len(content) * part)])
    with pytest.raises(FileError, match=r"case\.h5' is damaged or cut short .*copy it again"):
        Recording.load(saved)


@pytest.mark.parametrize("name", ["presses/0000/forces", "gravity"])
def test_damaged_dataset(record: Make, tmp_path: Path, name: str) -> None:
    """Also of numbers too few for gzip to shrink."""
    path = tmp_path / "case.h5"
    record(density=1e-9, gravity=np.array([1234.5678, 2345.6789, -9812.3456])).save(path)
    with h5py.File(path) as file:
        chunk = file[name].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0x01
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=rf"case\.h5' dataset '{name}' is damaged"):
        Recording.load(path)


@settings(max_examples=150)
@given(st.data())
def test_no_flipped_byte_escapes_as_another_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "flipped.h5"
    if not path.exists():
        mesh = box_mesh((10.0, 10.0, 10.0), 1)
        whole = np.ones((8, 3))
        press = Press(whole, whole > 0, whole, springs=whole)
        Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.3)).save(path)
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    broken = path.with_name("broken.h5")
    broken.write_bytes(content)
    said = ""
    try:
        Recording.load(broken)
    except (FileError, RecordingError) as error:
        said = str(error)
    # Not every byte matters; an error names the file.
    assert not said or "broken.h5" in said


def drop(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(name)


def put(name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = value

    return change


def invert(file: h5py.File) -> None:
    tets = file["mesh/tets"]
    tets[0] = tets[0][[1, 0, 2, 3]]


def mark(group: str, name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if value is None:
            del file[group].attrs[name]
        else:
            file[group].attrs[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (mark("/", "format", None), "has format None"),
        (mark("/", "format", "other"), "has format 'other'"),
        (mark("/", "version", 18), "has version 18, and this tactorch reads up to 17; upgrade"),
        (mark("/", "version", 0), "has version 0, which never existed"),
        (mark("/", "version", "one"), "attribute 'version' of '/' is 'one'; int is needed"),
        (mark("/", "units", "m"), "is in units 'm'"),
        (drop("mesh/points"), "lacks dataset 'mesh/points'"),
        (drop("mesh"), "lacks dataset 'mesh/points'"),
        (put("mesh/points", np.zeros((27, 2))), r"'mesh/points' has shape \(27, 2\); \(any, 3\)"),
        (put("mesh/points", np.zeros((27, 3))), "dataset 'mesh' is not a valid mesh"),
        (invert, "dataset 'mesh' is not a valid mesh: .*inverted"),
        (put("mesh/tets", np.zeros((48, 4))), "'mesh/tets' has dtype float64; int64 is needed"),
        (drop("material"), "lacks group 'material'"),
        (mark("material", "poisson", 0.6), "'material' is not valid: .*poisson is 0.6"),
        (mark("material", "parameters", "{"), "'material/parameters' is not JSON"),
        (mark("material", "parameters", "[1]"), "a JSON object is needed"),
        (drop("provenance"), "lacks dataset 'provenance'"),
        (put("provenance", 3.0), "dataset 'provenance' is not text"),
        (put("truth", np.ones(7)), r"'truth' has shape \(7,\); \(48\) is needed"),
        (put("truth", -np.ones(48)), "is not consistent: truth is -1"),
        (drop("presses"), "lacks group 'presses'"),
        (drop("presses/0000"), "declares 1 presses .* and holds 0"),
        (drop("presses/0000/forces"), "lacks dataset 'presses/0000/forces'"),
        (mark("presses", "count", 2), "declares 2 presses .* and holds 1"),
        (mark("presses", "count", 10**9), "declares 1000000000 presses .* and holds 1"),
        (mark("presses", "count", -1), "declares -1 presses .* and holds 1"),
        (mark("presses", "count", np.ones(3, int)), "is \\(3,\\); int is needed"),
        (mark("presses", "count", 0), "presses is empty"),
        (drop("presses/0000/springs"), "lacks dataset 'presses/0000/springs'"),
        (put("presses/0000/forces", np.zeros((9, 3))), r"forces' has shape \(9, 3\); \(27, 3\)"),
        (put("presses/0000/forces", np.full((27, 3), "x", "S1")), r"forces' has dtype \|S1"),
        (put("presses/0000/forces", np.full((27, 3), np.nan)), "'presses/0000' is not valid"),
        (put("presses/0000/observed", np.ones((27, 3))), "observed' has dtype float64; uint8"),
        (put("presses/0000/observed", np.full((27, 3), 2, np.uint8)), "other than 0 and 1"),
        (put("presses/0000/direction", np.ones(2)), r"direction' has shape \(2,\); \(3\)"),
        (mark("presses/0000", "noise_mm", "x"), "attribute 'noise_mm' of 'presses/0000'"),
    ],
)
def test_refuses_by_file_and_dataset(
    saved: Path, change: Callable[[h5py.File], None], says: str
) -> None:
    with h5py.File(saved, "r+") as file:
        change(file)
    with pytest.raises(RecordingError, match=rf"^recording '.*case\.h5' .*{says}"):
        Recording.load(saved)


BLOCK = box_mesh(10.0, 2)
HELD = np.zeros((27, 3), dtype=bool)
HELD[BLOCK.points[:, 2] < 1.0] = True
HELD.setflags(write=False)


def probe_press(k: int, **fields: Any) -> Press:
    """Return a press by a ball, each with other numbers."""
    at = np.array([0.1 * k, 0.0, 8.0 - 0.01 * k])
    own: dict[str, Any] = {
        "direction": np.array([0.0, 0.0, -1.0]), "noise_mm": None if k % 2 else 0.1,
        "fixed": HELD, "step": k, "name": f"n\N{DEGREE SIGN}{k}",
        "force": ForceReading.along([0.0, 0.0, 1.0], 0.5 + k, 0.01),
    }  # fmt: skip
    return Press.by_probe(ProbePose(Ball(3.0), at, deviation_mm=0.1 * (k % 2)), 27, **own | fields)


def palpation(*presses: Press) -> Recording:
    return Recording(BLOCK, presses, MaterialSpec("linear", 0.45))


def same_presses(one: Recording, other: Recording) -> None:
    for a, b in zip(one.presses, other.presses, strict=True):
        assert (a.name, a.step, a.noise_mm) == (b.name, b.step, b.noise_mm)
        assert digest(a) == digest(b)


@pytest.fixture
def stacked(tmp_path: Path) -> Path:
    path = tmp_path / "case.h5"
    palpation(*map(probe_press, range(5))).save(path)
    return path


def test_presses_by_one_probe_share_a_group(stacked: Path) -> None:
    with h5py.File(stacked) as file:
        assert file.attrs["version"] == 12
        assert list(file["presses"]) == ["0000"]
        assert file["presses/0000/fixed"].shape == (27, 3)
        assert file["presses/0000/force/values"].shape == (5, 1)
    loaded = Recording.load(stacked)
    same_presses(loaded, palpation(*map(probe_press, range(5))))
    assert loaded.presses[0].fixed is loaded.presses[4].fixed


def test_presses_with_other_nodal_fields_have_other_groups(tmp_path: Path) -> None:
    free = HELD.copy()
    free[-1] = True
    surface = SurfaceReading(np.zeros((1, 3)), np.eye(3)[:1], np.ones(1), np.ones(1))
    nodal = Press(np.ones((27, 3)), ~HELD, np.ones((27, 3)), fixed=HELD)
    recording = palpation(
        probe_press(0), probe_press(1), nodal, nodal, probe_press(2, fixed=free),
        probe_press(3, fixed=free), probe_press(4, surface=surface),
    )  # fmt: skip
    recording.save(tmp_path / "case.h5")
    with h5py.File(tmp_path / "case.h5") as file:
        assert list(file["presses"]) == ["0000", "0002", "0003", "0004", "0006"]
    same_presses(Recording.load(tmp_path / "case.h5"), recording)


def test_a_press_is_appended_to_presses_that_share_a_group(stacked: Path) -> None:
    presses = [probe_press(k) for k in range(8)]
    for k in range(5, 8):
        assert append_press(stacked, presses[k]) == k
    same_presses(Recording.load(stacked), palpation(*presses))
    compact(stacked)
    same_presses(Recording.load(stacked), palpation(*presses))
    with h5py.File(stacked) as file:
        assert file.attrs["version"] == 12


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (mark("presses", "count", 6), "declares 6 presses .* and holds 5"),
        (drop("presses/0000/names"), "lacks dataset 'presses/0000/names'"),
        (put("presses/0000/names", b'["a"]'), "not a list of 5 texts"),
        (put("presses/0000/step", np.zeros(0, int)), "step' is empty"),
        (put("presses/0000/step", np.zeros(6, int)), r"\(6,\) is needed|of 6"),
        (put("presses/0000/step", -np.ones(5, int)), "'presses/0000' is not val"),
        (
            put("presses/0000/force/values", np.ones((4, 1))),
            r"force/values' has shape \(4, 1\); \(5, any\)",
        ),
        (
            put("presses/0000/force/values", np.full((5, 1), np.nan)),
            "'presses/0000' is not valid: force: values",
        ),
    ],
)
def test_damaged_groups_are_refused(
    stacked: Path, change: Callable[[h5py.File], None], says: str
) -> None:
    with h5py.File(stacked, "r+") as file:
        change(file)
    with pytest.raises(RecordingError, match=rf"^recording '.*case\.h5' .*({says})"):
        Recording.load(stacked)


def test_one_broken_press_of_a_group_leaves_the_others(stacked: Path) -> None:
    with h5py.File(stacked, "r+") as file:
        file["presses/0000/force/values"][2] = np.nan
    found = read_presses(stacked)
    assert list(found.presses) == [0, 1, 3, 4]
    assert "force: values" in found.faults[2]


def test_suspects_units_when_loading(saved: Path) -> None:
    with h5py.File(saved, "r+") as file:
        file["truth"][:] = 200.0
    with pytest.raises(RecordingError, match=r"case\.h5' .*kPa"):
        Recording.load(saved)
    assert Recording.load(saved, check_units=False).truth is not None


def external_link(file: h5py.File, name: str, other: Path) -> None:
    file[name] = h5py.ExternalLink(str(other), "secret")


def soft_link(file: h5py.File, name: str, other: Path) -> None:
    file["elsewhere"] = h5py.ExternalLink(str(other), "/")
    file[name] = h5py.SoftLink("/elsewhere/secret")


def external_storage(file: h5py.File, name: str, other: Path) -> None:
    with h5py.File(other) as source:
        shape, dtype = source["secret"].shape or (1,), source["secret"].dtype
    size = int(np.prod(shape)) * dtype.itemsize
    file.create_dataset(name, shape, dtype, external=[(str(other), 0, size)])


def virtual_dataset(file: h5py.File, name: str, other: Path) -> None:
    with h5py.File(other) as source:
        layout = h5py.VirtualLayout(source["secret"].shape, source["secret"].dtype)
        layout[...] = h5py.VirtualSource(source["secret"])
    file.create_virtual_dataset(name, layout)


@pytest.mark.parametrize("lead", [external_link, soft_link, external_storage, virtual_dataset])
@pytest.mark.parametrize("name", ["presses/0000/forces", "truth", "provenance", "mesh/tets"])
def test_other_files_are_never_read(
    saved: Path, lead: Callable[[h5py.File, str, Path], None], name: str
) -> None:
    """What other files of the reader's machine hold must not reach results and reports."""
    other = saved.with_name("private.h5")
    with h5py.File(saved, "r+") as file, h5py.File(other, "w") as private:
        file.copy(name, private, name="secret")
        del file[name]
    with h5py.File(saved, "r+") as file:
        lead(file, name, other)
    with pytest.raises(RecordingError, match=rf"'{name}' is .*copy"):
        Recording.load(saved)


def test_a_whole_group_of_another_file_is_never_read(saved: Path) -> None:
    other = saved.with_name("private.h5")
    other.write_bytes(saved.read_bytes())
    with h5py.File(saved, "r+") as file:
        del file["presses"]
        file["presses"] = h5py.ExternalLink(str(other), "presses")
    with pytest.raises(RecordingError, match="'presses' is an external link"):
        Recording.load(saved)


@pytest.mark.parametrize(
    ("name", "shape", "chunks"),
    [
        ("mesh/points", (10**12, 3), True),
        ("unloaded", (10**12, 27, 3), True),
        ("mesh/tets", (10**10, 4), None),
        ("provenance", (), None),
    ],
)
def test_shapes_that_the_file_does_not_hold_are_refused(
    saved: Path, name: str, shape: tuple[int, ...], chunks: bool | None
) -> None:
    with h5py.File(saved, "r+") as file:
        if name in file:
            del file[name]
        kind = {"mesh/tets": "i8", "provenance": "S2000000000"}.get(name, "f8")
        file.create_dataset(name, shape, kind, chunks=chunks)
    with pytest.raises(RecordingError, match=rf"dataset '{name}' has shape .* never written"):
        Recording.load(saved)


def test_changed_provenance_is_noticed(record: Make, tmp_path: Path) -> None:
    path = tmp_path / "case.h5"
    record(provenance={"operator": "Ada"}).save(path)
    path.write_bytes(path.read_bytes().replace(b'"Ada"', b'"Eve"'))
    with pytest.raises(RecordingError, match=r"'provenance' is damaged \(its checksum differs"):
        Recording.load(path)


def test_deeply_nested_provenance_is_refused(saved: Path) -> None:
    with h5py.File(saved, "r+") as file:
        del file["provenance"]
        file["provenance"] = np.bytes_("[" * 100_000)
    with pytest.raises(RecordingError, match=r"'provenance' of.*nested deeper"):
        Recording.load(saved)
