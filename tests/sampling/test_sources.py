import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tactorch.errors import ConfigError, RecordingError
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording, append_press
from tactorch.recording.append import OtherObjectError, digest
from tactorch.sampling import RecordingSource
from tactorch.simulation import PressPlan, simulate


def keys(source: RecordingSource) -> list[str]:
    return [arrival.key for arrival in source.poll()]


@pytest.fixture
def notes() -> list[str]:
    return []


def test_presses_come_once_in_their_order(path: Path, whole: Recording) -> None:
    source = RecordingSource(path)
    assert keys(source) == []
    whole.select([0, 1]).save(path)
    first = source.poll()
    assert [one.key for one in first] == ["session.h5, press 1", "session.h5, press 2"]
    assert [one.digest for one in first] == [digest(press) for press in whole.presses[:2]]
    assert keys(source) == []
    append_press(path, whole.presses[2])
    assert keys(source) == ["session.h5, press 3"]
    assert source.about is not None
    assert len(source.about.presses) == 3


def test_a_folder_gives_its_recordings_by_name_and_follows_each(
    tmp_path: Path, whole: Recording
) -> None:
    source = RecordingSource(tmp_path)
    assert keys(source) == []
    whole.select([1]).save(tmp_path / "b.h5")
    whole.select([0]).save(tmp_path / "a.h5")
    (tmp_path / "notes.txt").write_text("not a recording")
    whole.select([3]).save(tmp_path / ".hidden.h5")
    assert keys(source) == ["a.h5, press 1", "b.h5, press 1"]
    append_press(tmp_path / "a.h5", whole.presses[2])
    assert keys(source) == ["a.h5, press 2"]


def test_a_half_written_file_is_tried_again_and_told_only_after_a_while(
    path: Path, whole: Recording, notes: list[str], tmp_path: Path
) -> None:
    done = tmp_path / "done" / "session.h5"
    whole.save(done)
    content = done.read_bytes()
    source = RecordingSource(path, patience_seconds=1e6, report=notes.append)
    for share in (0.0, 0.3, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        assert keys(source) == []
    assert notes == []
    path.write_bytes(content)
    assert len(keys(source)) == 4

    hasty = RecordingSource(tmp_path, patience_seconds=0.0, report=notes.append)
    (tmp_path / "half.h5").write_bytes(content[:900])
    path.unlink()
    for _ in range(3):
        assert keys(hasty) == []
    assert len(notes) == 1
    assert "half.h5" in notes[0]
    assert "tried again" in notes[0]
    (tmp_path / "half.h5").write_bytes(content)
    assert len(keys(hasty)) == 4


def test_a_broken_press_is_told_once_and_passed_over(
    path: Path, whole: Recording, notes: list[str]
) -> None:
    source = RecordingSource(path, report=notes.append)
    whole.select([0, 1]).save(path)
    with h5py.File(path, "r+") as file:
        forces = file["presses/0001/forces"]
        forces[...] = np.where(forces[...] != 0, np.nan, 0.0)
    assert keys(source) == ["session.h5, press 1"]
    append_press(path, whole.presses[2])
    assert keys(source) == ["session.h5, press 3"]
    assert len(notes) == 1
    assert notes[0].startswith("session.h5, press 2 is invalid and skipped: ")
    assert "NaN" in notes[0]


def test_another_object_ends_it(tmp_path: Path, whole: Recording) -> None:
    source = RecordingSource(tmp_path)
    whole.save(tmp_path / "a.h5")
    assert len(source.poll()) == 4
    other = simulate(
        make_phantom("cube_sphere", radius=0.45),
        PressPlan(("z+",), (0.01,)),
        mesh=box_mesh(10.0, 2, tets_per_cell=5),
        samples=4,
    )
    other.save(tmp_path / "b.h5")
    with pytest.raises(OtherObjectError, match=r"b\.h5.*another object.*40 elements.*135"):
        source.poll()


@pytest.mark.parametrize("presses", [[0], [1, 0]])
def test_a_recording_that_was_replaced_ends_it(
    path: Path, whole: Recording, presses: list[int]
) -> None:
    source = RecordingSource(path)
    whole.select([0, 1]).save(path)
    source.poll()
    whole.select(presses).save(path)
    with pytest.raises(RecordingError, match="replaced"):
        source.poll()


def test_a_file_that_vanishes_for_a_while_is_waited_for(path: Path, whole: Recording) -> None:
    source = RecordingSource(path)
    whole.select([0]).save(path)
    assert len(source.poll()) == 1
    shutil.move(path, path.with_suffix(".away"))
    assert keys(source) == []
    shutil.move(path.with_suffix(".away"), path)
    append_press(path, replace(whole.presses[1], name="again"))
    assert keys(source) == ["session.h5, press 2"]


def test_what_can_be_no_source_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="neither a folder nor a recording"):
        RecordingSource(tmp_path / "none")


def test_declared_presses_that_are_not_there_end_it(
    path: Path, whole: Recording, notes: list[str]
) -> None:
    """The file can be read: waiting does not repair it. Others of a folder are still read."""
    whole.select([0]).save(path)
    with h5py.File(path, "r+") as file:
        file["presses"].attrs["count"] = 1_000_000_000
    with pytest.raises(RecordingError, match="declares 1000000000 presses"):
        RecordingSource(path, patience_seconds=0.0).poll()
    whole.select([1]).save(path.with_name("z.h5"))
    source = RecordingSource(path.parent, patience_seconds=0.0, report=notes.append)
    assert keys(source) == ["z.h5, press 1"]
    assert len(notes) == 1
    assert "declares 1000000000 presses" in notes[0]
