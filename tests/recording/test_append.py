import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tactorch.errors import FileError, RecordingError
from tactorch.mesh import box_mesh
from tactorch.recording import (
    MaterialSpec,
    Press,
    Recording,
    append_press,
    compact,
    read_presses,
)
from tactorch.recording.append import OtherObjectError, digest
from tactorch.recording.schema import written_version


@pytest.fixture
def path(record: Callable[..., Recording], tmp_path: Path) -> Path:
    place = tmp_path / "session.h5"
    record().save(place)
    return place


@pytest.fixture
def second(record: Callable[..., Recording]) -> Press:
    return record({"name": "second", "step": 1, "noise_mm": 0.002}).presses[0]


def test_an_appended_press_is_as_if_saved_with_the_others(path: Path, second: Press) -> None:
    before = Recording.load(path)
    assert append_press(path, second) == 1
    after = Recording.load(path)
    assert [press.name for press in after.presses] == ["top", "second"]
    assert digest(after.presses[1]) == digest(second)
    assert digest(after.presses[0]) == digest(before.presses[0]) != digest(second)
    assert after.mesh.content_hash() == before.mesh.content_hash()
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("presses_before", [1, 2])
def test_a_writer_that_dies_leaves_what_was_there(
    path: Path, second: Press, monkeypatch: pytest.MonkeyPatch, presses_before: int
) -> None:
    """The first append rewrites the file, the second one adds to its end."""
    if presses_before == 2:
        append_press(path, second)
    content = path.read_bytes()

    def die(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tactorch.recording.append.write_attributes", die)
    monkeypatch.setattr("tactorch.recording.append._write_at", die)
    with pytest.raises(KeyboardInterrupt):
        append_press(path, second)
    assert path.read_bytes() == content
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.99])
@pytest.mark.parametrize("zeros", [0, 1000])
def test_half_an_appended_press_is_ignored_and_written_over(
    path: Path, second: Press, part: float, zeros: int, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):
        append_press(path, second)
    before = path.stat().st_size
    append_press(path, replace(second, name="lost"))
    record = path.read_bytes()[before:]
    with open(path, "r+b") as file:
        file.truncate(before + int(part * len(record)))
        file.seek(0, 2)
        file.write(b"\0" * (zeros if part == 0.0 else 0))
    assert [press.name for press in Recording.load(path).presses] == ["top", "second", "second"]
    assert ("incomplete press" in caplog.text) == (path.stat().st_size > before)
    assert read_presses(path).count == 3
    assert append_press(path, replace(second, name="third")) == 3
    assert Recording.load(path).presses[3].name == "third"


def test_appending_writes_no_more_than_the_press(path: Path, second: Press) -> None:
    """Bytes written, all in all, stay proportional to the file; nothing is copied for a press."""
    append_press(path, second)
    written, size, content = 0, path.stat().st_size, path.read_bytes()
    for _ in range(30):
        append_press(path, second)
        after = path.read_bytes()
        assert after.startswith(content)
        written, content = written + len(after) - len(content), after
    assert len(Recording.load(path).presses) == 32
    assert written == path.stat().st_size - size


def test_a_long_tail_is_merged(path: Path, second: Press, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactorch.recording.append._MAX_SMALL_TAIL_BYTES", 0)
    for number in range(20):
        append_press(path, replace(second, name=f"press {number}"))
    with h5py.File(path) as file:
        assert len(file["presses"]) > 10
    names = [press.name for press in Recording.load(path).presses]
    assert names == ["top", *(f"press {number}" for number in range(20))]


def test_compact_makes_a_plain_file(path: Path, second: Press) -> None:
    for _ in range(3):
        append_press(path, second)
    before = Recording.load(path)
    compact(path)
    with h5py.File(path) as file:
        assert file.attrs["version"] == written_version(regions=False)
        assert len(file["presses"]) == file["presses"].attrs["count"] == 4
    after = Recording.load(path)
    assert [digest(press) for press in after.presses] == [digest(p) for p in before.presses]
    content = path.read_bytes()
    compact(path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("place", ["header", "image"])
def test_a_damaged_appended_press_is_named(path: Path, second: Press, place: str) -> None:
    append_press(path, second)
    begin = path.stat().st_size
    for _ in range(2):
        append_press(path, second)
    content = bytearray(path.read_bytes())
    content[begin + {"header": 20, "image": 300}[place]] ^= 1
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"session\.h5' is damaged at press 3"):
        Recording.load(path)
    if place == "image":
        contents = read_presses(path)
        assert list(contents.presses) == [0, 1, 3]
        assert "checksum" in contents.faults[2]


def test_files_of_an_older_structure_grow_too(path: Path, second: Press, tmp_path: Path) -> None:
    old = tmp_path / "old.h5"
    with h5py.File(path) as file, h5py.File(old, "w", libver="earliest") as target:
        for name in file:
            file.copy(name, target)
        for name, value in file.attrs.items():
            target.attrs[name] = value
    for _ in range(2):
        append_press(old, second)
    assert [press.name for press in Recording.load(old).presses] == ["top", "second", "second"]


def test_a_reader_never_sees_half_a_press(path: Path) -> None:
    """Another process appends as fast as it can, while this one reads."""
    writer = """
import sys
from tactorch.recording import Recording, append_press
press = Recording.load(sys.argv[1]).presses[0]
for _ in range(10):
    append_press(sys.argv[1], press)
"""
    process = subprocess.Popen([sys.executable, "-c", writer, str(path)])
    counts = []
    while process.poll() is None:
        found = read_presses(path)
        assert not found.faults
        assert len(found.presses) == found.count
        counts.append(found.count)
    assert process.returncode == 0
    assert counts == sorted(counts)
    assert read_presses(path).count == 11


def test_what_cannot_be_appended_is_refused(
    path: Path, second: Press, fields: dict[str, Any], tmp_path: Path
) -> None:
    other = Press(**{k: v[:-1] if isinstance(v, np.ndarray) else v for k, v in fields.items()})
    with pytest.raises(RecordingError, match="26 nodes but the mesh has 27"):
        append_press(path, other)
    with pytest.raises(RecordingError, match="forces are all 0"):
        append_press(path, replace(second, forces=np.zeros_like(second.forces)))
    with pytest.raises(FileError, match=r"none\.h5"):
        append_press(tmp_path / "none.h5", second)
    assert read_presses(path).count == 1


def spoil(path: Path, index: int, field: str, value: float) -> None:
    with h5py.File(path, "r+") as file:
        values = file[f"presses/{index:04d}/{field}"]
        values[...] = np.where(values[...] != 0, value, 0.0)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [("forces", np.nan, "NaN or infinite"), ("displacement", 900.0, "micrometres given")],
)
def test_a_broken_press_is_told_and_the_others_are_read(
    path: Path, second: Press, field: str, value: float, words: str
) -> None:
    for _ in range(2):
        append_press(path, second)
    compact(path)
    spoil(path, 1, field, value)
    found = read_presses(path)
    assert list(found.presses) == [0, 2]
    assert words in found.faults[1]
    assert str(path) not in found.faults[1]
    assert found.recording is not None
    assert len(found.recording.presses) == 2


def test_only_new_presses_are_read_where_some_are_known(path: Path, second: Press) -> None:
    known = read_presses(path).recording
    append_press(path, second)
    found = read_presses(path, after=1, known=known)
    assert list(found.presses) == [1]
    assert found.count == 2


def test_a_light_touch_after_a_firm_one_is_no_wrong_unit(path: Path, second: Press) -> None:
    light = replace(second, displacement=1e-4 * second.displacement, forces=1e-4 * second.forces)
    append_press(path, light)
    assert list(read_presses(path).presses) == [0, 1]
    known = read_presses(path).recording
    assert list(read_presses(path, after=1, known=known).presses) == [1]


def test_another_object_is_refused(path: Path, record: Callable[..., Recording]) -> None:
    stiff = record(material=MaterialSpec("neo_hookean", 0.3))
    with pytest.raises(OtherObjectError, match=r"has material=.*, the presses before"):
        read_presses(path, known=stiff)
    mesh = box_mesh(11.0, 2)
    with pytest.raises(OtherObjectError, match="another object"):
        read_presses(path, known=record(mesh=mesh))
    down, along = (
        record(density=1e-9, gravity=np.array(g)) for g in ((0, 0, -9810.0), (0, -9810.0, 0))
    )
    along.save(path)
    with pytest.raises(
        OtherObjectError, match=r"gravity=\[0.0, -9810.0, 0.0\], the presses before"
    ):
        read_presses(path, known=down)
    record(density=1.1e-9, gravity=np.array((0, 0, -9810.0))).save(path)
    with pytest.raises(OtherObjectError, match=r"density=1.1e-09, the presses before 1e-09"):
        read_presses(path, known=down)


def test_a_file_that_is_cut_short_cannot_be_read(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(FileError, match="cut short"):
        read_presses(path)


def test_declared_presses_that_are_not_there_are_refused_at_once(path: Path) -> None:
    """The number is an attribute that anybody can set: it must not bound a loop."""
    with h5py.File(path, "r+") as file:
        file["presses"].attrs["count"] = 1_000_000_000
    for read in (read_presses, Recording.load):
        with pytest.raises(RecordingError, match=r"declares 1000000000 presses.*holds 1"):
            read(path)
