import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.generation import PressDraw, Recipe, SampleSet, generate, make_sample
from tactorch.inverse import GaussNewton, Settings

Make = Callable[..., Recipe]


def sums(found: SampleSet) -> list[str]:
    return [shard["sha256"] for shard in found.manifest["shards"]]


def stop_at(*stops: int) -> Callable[[int, int, int], None]:
    """Control-C at these reports of progress."""
    calls = itertools.count(1)

    def progress(done: int, failed: int, total: int) -> None:
        if next(calls) in stops:
            raise KeyboardInterrupt

    return progress


@pytest.fixture(scope="module")
def made(make_recipe: Make, tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    """A small dataset with reconstructions, made undisturbed by one process."""
    recipe = make_recipe(inversion=Settings(GaussNewton(max_iterations=3)))
    return generate(recipe, tmp_path_factory.mktemp("made") / "tiny", workers=1)


@pytest.fixture
def recipe(make_recipe: Make) -> Recipe:
    return make_recipe(inversion=Settings(GaussNewton(max_iterations=3)))


def test_samples_are_those_of_the_recipe(made: SampleSet, recipe: Recipe) -> None:
    assert made.indices == (0, 1, 2, 3, 4)
    assert [shard["count"] for shard in made.manifest["shards"]] == [2, 2, 1]
    for sample in (made[0], made[4]):
        expected = make_sample(recipe, sample.index)
        assert (sample.label, sample.facts) == (expected.label, expected.facts)
        np.testing.assert_array_equal(sample.truth, expected.truth)
        np.testing.assert_allclose(sample.reconstruction, expected.reconstruction, rtol=1e-6)
        for press, other in zip(sample.recording.presses, expected.recording.presses, strict=True):
            np.testing.assert_array_equal(press.forces, other.forces)
            np.testing.assert_allclose(press.displacement, other.displacement, atol=1e-12)
        assert sample.figures.keys() == expected.figures.keys()
    assert not (made.folder / "partial").exists()


@pytest.mark.slow
def test_bytes_do_not_depend_on_workers_or_interruptions(
    made: SampleSet, recipe: Recipe, tmp_path: Path
) -> None:
    stop_twice = stop_at(3, 6)
    folder = tmp_path / "other"
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            generate(recipe, folder, workers=2, progress=stop_twice)
        with pytest.raises(FileError, match="unfinished"):
            SampleSet(folder)
    found = generate(recipe, folder, workers=2, progress=stop_twice)
    assert sums(found) == sums(made)
    found.verify()
    stamp = (folder / "shard-00000.h5").stat().st_mtime_ns
    assert sums(generate(recipe, folder)) == sums(made)
    assert (folder / "shard-00000.h5").stat().st_mtime_ns == stamp


def test_what_is_missing_is_made(made: SampleSet, recipe: Recipe, tmp_path: Path) -> None:
    """After Control-C, and after a shard was deleted."""
    with pytest.raises(KeyboardInterrupt):
        generate(recipe, tmp_path / "again", workers=1, progress=stop_at(3))
    with pytest.raises(FileError, match="unfinished"):
        SampleSet(tmp_path / "again")
    found = generate(recipe, tmp_path / "again", workers=1)
    assert sums(found) == sums(made)
    (found.folder / "shard-00001.h5").unlink()
    assert sums(generate(recipe, found.folder, workers=1)) == sums(made)


def test_failed_samples_are_recorded_with_their_reason(make_recipe: Make, tmp_path: Path) -> None:
    """Under a pressure far beyond the moduli the object collapses."""
    recipe = make_recipe(count=1, presses=PressDraw(p_max_mpa=(1.0, 1.0), steps=(1,)))
    found = generate(recipe, tmp_path / "bad", workers=1)
    assert len(found) == 0
    assert set(found.manifest["failed"]) == {"0"}
    assert "ConvergenceError" in found.manifest["failed"]["0"]
    with pytest.raises(FileError, match=r"sample 0 .* failed: ConvergenceError"):
        found[0]
    again = generate(recipe, tmp_path / "bad", workers=1)
    assert again.manifest == found.manifest


def test_another_recipe_is_refused_by_what_differs(made: SampleSet, make_recipe: Make) -> None:
    other = make_recipe(inversion=Settings(GaussNewton(max_iterations=4)))
    with pytest.raises(ConfigError, match=r"max_iterations is 3 there and 4 here"):
        generate(other, made.folder)
    with pytest.raises(ConfigError, match=r"inversion is given there only"):
        generate(make_recipe(), made.folder)
    with pytest.raises(ConfigError, match=r"seed is 0 there and 7 here"):
        generate(make_recipe(seed=7, inversion=Settings(GaussNewton(3))), made.folder)


def test_two_runs_do_not_share_a_folder(recipe: Recipe, tmp_path: Path) -> None:
    def again(done: int, failed: int, total: int) -> None:
        with pytest.raises(ConfigError, match="another run"):
            generate(recipe, tmp_path / "x")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(recipe, tmp_path / "x", progress=again)


def test_unknown_executor_and_missing_scheduler(recipe: Recipe, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="executor='threads'"):
        generate(recipe, tmp_path / "x", executor="threads")
    with pytest.raises(ConfigError, match="needs scheduler"):
        generate(recipe, tmp_path / "x", executor="dask")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_two_dask_workers_give_the_same_bytes(
    made: SampleSet, recipe: Recipe, tmp_path: Path
) -> None:
    """A real scheduler and two worker processes on loopback."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        found = generate(
            recipe, tmp_path / "dask", executor="dask", scheduler=cluster.scheduler_address
        )
    assert sums(found) == sums(made)


@pytest.mark.slow
def test_killed_at_random_moments_it_ends_with_the_same_bytes(
    made: SampleSet, tmp_path: Path
) -> None:
    """A process and its children, killed outright, again and again."""
    script = Path(__file__).with_name("_generate_tiny.py")
    folder, rng = tmp_path / "killed", np.random.default_rng(0)
    command = [sys.executable, str(script), str(folder)]
    kills = 0
    for start in range(30):
        process = subprocess.Popen(command, start_new_session=True)
        try:
            # A loaded machine may take longer to start than the first kills leave it.
            process.wait(timeout=float(rng.uniform(3.0, 9.0 + start)))
        except subprocess.TimeoutExpired:
            kills += 1
        os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
        process.wait()
        if (folder / "manifest.json").is_file():
            break
        time.sleep(0.2)
    assert kills > 0
    assert sums(SampleSet(folder)) == sums(made)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "shard-00000.h5").write_bytes(b"x" * 100), "shard-00000.h5' is damaged"),
        (lambda f: (f / "shard-00000.h5").unlink(), "not found: .*shard-00000.h5"),
        (lambda f: _change(f, version=99), "has version 99"),
        (lambda f: _change(f, format="other"), "is not the manifest"),
        (lambda f: (f / "manifest.json").write_text("{"), "cannot be read"),
        (lambda f: (f / "manifest.json").unlink(), "is unfinished"),
    ],
)
def test_damage_is_told_by_file(
    made: SampleSet, tmp_path: Path, spoil: Callable[[Path], object], message: str
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made.folder, folder)
    spoil(folder)
    with pytest.raises(FileError, match=message):
        SampleSet(folder)[0]


def test_changed_bytes_are_noticed(made: SampleSet, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made.folder, folder)
    shard = folder / "shard-00001.h5"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(bytes(content))
    with pytest.raises(FileError, match=r"shard-00001.h5' is damaged .*checksum"):
        SampleSet(folder).verify()


def test_generating_again_does_not_bless_changed_bytes(
    recipe: Recipe, made: SampleSet, tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made.folder, folder)
    shard = folder / "shard-00001.h5"
    shard.write_bytes(shard.read_bytes() + b"x")
    (folder / "shard-00000.h5").unlink()
    with pytest.raises(FileError, match=r"shard-00001.h5' is damaged"):
        generate(recipe, folder, workers=1)
    shard.unlink()
    assert sums(generate(recipe, folder, workers=1)) == sums(made)


def test_no_flipped_byte_escapes_as_another_error(made: SampleSet, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made.folder, folder)
    shard, rng = folder / "shard-00000.h5", np.random.default_rng(0)
    content = shard.read_bytes()
    for place in rng.integers(0, len(content), 60):
        changed = bytearray(content)
        changed[place] ^= 1 << int(rng.integers(8))
        shard.write_bytes(bytes(changed))
        with contextlib.suppress(FileError):
            SampleSet(folder)[0]


def test_what_breaks_a_sample_does_not_end_the_rest(
    make_recipe: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_module("tactorch.generation.generate")

    def broken(*_: object) -> None:
        raise np.linalg.LinAlgError("singular\nmatrix")

    monkeypatch.setattr(module, "make_sample", broken)
    assert module._make(make_recipe(), 3) == (3, None, "LinAlgError: singular matrix")


def test_unknown_numbers_and_folders(made: SampleSet, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="has no sample 5"):
        made[5]
    with pytest.raises(FileError, match="dataset not found"):
        SampleSet(tmp_path / "nowhere")


def test_sets_travel_to_other_processes(made: SampleSet) -> None:
    import pickle

    assert made[0].index == 0
    copy = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(copy[3].truth, made[3].truth)


def _change(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
