"""Going on where a run ended: by itself, by Ctrl-C, by its iteration limit."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.inverse import Monitor, Reconstruction

RUN = (
    *("plots=false", "method=map", "run_dir=run"),
    *("regularization.weight=5", "optimizer.tolerance=1e-9"),
)


def load(folder: str = "run") -> Reconstruction:
    return Reconstruction.load(Path(folder, "reconstruction.h5"))


def test_resumed_run_equals_one_that_was_never_stopped(tactorch: Any, recording: Path) -> None:
    start = ("invert", f"recording={recording}", *RUN)
    assert tactorch(*start, "optimizer.max_iterations=2").status == 0
    assert load().iterations == 2
    done = tactorch("invert", "resume=run", "optimizer.max_iterations=4")
    assert done.status == 0, done.err
    resumed = load()
    assert tactorch(*start, "run_dir=whole", "optimizer.max_iterations=4").status == 0
    whole = load("whole")
    assert resumed.iterations == whole.iterations == 4
    np.testing.assert_allclose(resumed.youngs, whole.youngs, rtol=1e-9)
    misfits = [[record["misfit"] for record in run.history] for run in (resumed, whole)]
    np.testing.assert_allclose(*misfits, rtol=1e-6)


@pytest.mark.slow
def test_killed_run_goes_on_from_its_checkpoint(tactorch: Any, recording: Path) -> None:
    start = ("invert", f"recording={recording}", *RUN, "optimizer.max_iterations=3")
    code = (
        "import os, signal, sys\n"
        "from tactorch.cli import main\n"
        "from tactorch.inverse import Monitor\n"
        "accept = Monitor.accept\n"
        "def killed(self, *arguments, **record):\n"
        "    accept(self, *arguments, **record)\n"
        "    if self.iteration == 2: os.kill(os.getpid(), signal.SIGKILL)\n"
        "    self.save()\n"
        "Monitor.accept = killed\n"
        "main(sys.argv[1:])\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *start], timeout=120, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    left = {path.name for path in Path("run").iterdir()}
    assert left == {".hydra", "invert.log", "checkpoint.npz"}
    assert tactorch("invert", "resume=run").status == 0
    assert tactorch(*start, "run_dir=whole").status == 0
    assert load().iterations == load("whole").iterations == 3
    np.testing.assert_allclose(load().youngs, load("whole").youngs, rtol=1e-9)


def test_a_run_stopped_before_its_first_checkpoint_starts_anew(
    tactorch: Any, recording: Path
) -> None:
    start = ("invert", f"recording={recording}", *RUN, "optimizer.max_iterations=2")
    assert tactorch(*start).status == 0
    expected = load().youngs
    Path("run/checkpoint.npz").unlink()
    finished = tactorch("invert", "resume=run")
    assert finished.status == 2
    assert "holds the results" in finished.err
    for path in Path("run").glob("[!.]*"):
        path.unlink()
    done = tactorch("invert", "resume=run")
    assert done.status == 0, done.err
    assert "stopped before its first checkpoint" in done.err
    np.testing.assert_allclose(load().youngs, expected, rtol=1e-9)


def test_resume_repeats_the_settings_of_the_run(tactorch: Any, recording: Path) -> None:
    tactorch(
        "invert", f"recording={recording}", "run_dir=run", "plots=false", "method=map",
        "optimizer=lbfgs", "optimizer.max_iterations=2",
    )  # fmt: skip
    done = tactorch("invert", "resume=run", "optimizer.max_iterations=3", "run_dir=further")
    assert done.status == 0, done.err
    further = load("further")
    assert further.config["optimizer"]["name"] == "lbfgs"
    assert further.iterations == 3
    assert load().iterations == 2


def test_finished_run_can_be_resumed(tactorch: Any, recording: Path) -> None:
    tactorch("invert", f"recording={recording}", *RUN, "optimizer.max_iterations=2")
    before = load()
    done = tactorch("invert", "resume=run")
    assert done.status == 0, done.err
    again = tactorch("invert", "resume=run", "optimizer.max_iterations=2")
    assert again.status == 0, again.err
    assert load().misfit_mm2 <= before.misfit_mm2


def test_resume_finds_a_recording_given_relative_to_another_folder(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("case.h5").write_bytes(recording.read_bytes())
    tactorch("invert", "recording=case.h5", *RUN, "optimizer.max_iterations=1")
    Path("deeper").mkdir()
    monkeypatch.chdir("deeper")
    done = tactorch("invert", "resume=../run", "optimizer.max_iterations=2")
    assert done.status == 0, done.err
    assert load("../run").iterations == 2


def test_interruption_writes_the_best_map_and_says_so(
    tactorch: Any, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept = Monitor.accept

    def interrupted(self: Monitor, *arguments: Any, **record: float) -> None:
        accept(self, *arguments, **record)
        if self.iteration == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Monitor, "accept", interrupted)
    done = tactorch("invert", f"recording={recording}", *RUN)
    assert done.status == 130
    assert "interrupted; continue with tactorch invert resume=run\n" in done.err
    assert load().stop_reason == "interrupted"
    assert load().iterations == 1


@pytest.mark.slow
def test_demo_resumes_too(tactorch: Any, published: Path) -> None:
    case = ("source=published", f"path={published}")
    assert tactorch("demo", *case, *RUN, "optimizer.max_iterations=1").status == 0
    done = tactorch("demo", "resume=run", "optimizer.max_iterations=2")
    assert done.status == 0, done.err
    assert load().iterations == 2


ATTACK = "+hydra.callbacks.x._target_=numpy.savetxt"


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        (ATTACK, "numpy.savetxt"),
        ("hydra.run.dir=elsewhere", "unknown setting 'hydra.run.dir'"),
        ("hydra/launcher=joblib", "unknown setting 'hydra/launcher'"),
        ("+anything=1", "unknown setting 'anything'"),
        ("~optimizer.tolerance", "would remove a setting"),
        ("regularization.weight={_target_: os.system}", "no plain value"),
        ("recording=${oc.env:HOME}", "no plain value"),
        ("recording=${ oc.env:HOME}", "no plain value"),
        ("recording=${${optimizer.name}.env:HOME}", "no plain value"),
        ("optimizer.max_iterations=1,2", "several values"),
    ],
)
def test_a_run_folder_gives_plain_settings_only(
    tactorch: Any, finished_run: Path, tmp_path: Path, word: str, reason: str
) -> None:
    run = Path(shutil.copytree(finished_run, tmp_path / "run"))
    overrides = run / ".hydra" / "overrides.yaml"
    overrides.write_text(f"{overrides.read_text()}- '{word}'\n")
    done = tactorch("invert", f"resume={run}")
    assert done.status == 2
    assert "overrides.yaml' holds more than plain settings" in done.err
    assert reason in done.err
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("experiment/x.yaml", "hydra:\n  callbacks:\n    x:\n      _target_: numpy.savetxt\n"),
        ("experiment/x.yaml", "defaults:\n  - override /hydra/launcher: joblib\n"),
        ("regularization/x.yaml", "name: tikhonov\nweight:\n  _target_: os.system\n"),
        ("hydra/callbacks/x.yaml", "y: 1\n"),
        ("experiment/x.yaml", "# @package _global_\nrecording: ${ oc.env:HOME}\n"),
    ],
)
def test_a_folder_of_settings_gives_plain_settings_only(
    tactorch: Any, recording: Path, tmp_path: Path, name: str, text: str
) -> None:
    path = tmp_path / "own" / name
    path.parent.mkdir(parents=True)
    path.write_text(text)
    done = tactorch(
        "invert", f"recording={recording}", "--config-dir", tmp_path / "own", "experiment=x"
    )
    assert done.status == 2
    assert "can run programs or read the environment" in done.err
    assert "--trust-config-dir" in done.err
    assert not list(Path().iterdir())


def test_presets_and_experiments_of_a_folder_are_used(
    tactorch: Any, recording: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    for folder in ("experiment", "regularization"):
        (own / folder).mkdir(parents=True)
    (own / "regularization" / "mine.yaml").write_text("name: matern\nlength_mm: 2.5\n")
    (own / "experiment" / "mine.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /regularization: mine\nplots: false\n"
    )
    command = ("invert", f"recording={recording}", "--config-dir", own)
    out = tactorch(*command, "experiment=mine", "--cfg", "job").out
    assert "name: matern" in out
    assert "length_mm: 2.5" in out
    assert "plots: false" in out
    done = tactorch(*command, "regularization=mne")
    assert "Did you mean 'mine'?" in done.err
    (own / "regularization" / "mine.yaml").write_text("name: matern\nlenght_mm: 2.5\n")
    assert "unknown setting 'lenght_mm'" in tactorch(*command).err
    assert "not a folder" in tactorch("invert", "--config-dir", "nowhere").err


def test_a_folder_of_settings_may_refer_to_hydra(tactorch: Any, tmp_path: Path) -> None:
    experiment = tmp_path / "own" / "experiment" / "mine.yaml"
    experiment.parent.mkdir(parents=True)
    experiment.write_text("run_dir: outputs/${hydra:job.name}/x\nout: hydra/x.h5\n")
    done = tactorch("simulate", "--config-dir", tmp_path / "own", "experiment=mine", "--cfg", "job")
    assert done.status == 0, done.err
    assert "run_dir: outputs/${hydra:job.name}/x" in done.out
    assert "out: hydra/x.h5" in done.out


def test_a_trusted_folder_is_composed_by_hydra(
    tactorch: Any, recording: Path, tmp_path: Path
) -> None:
    experiment = tmp_path / "own" / "experiment" / "x.yaml"
    experiment.parent.mkdir(parents=True)
    experiment.write_text("# @package _global_\nhydra:\n  job:\n    name: renamed\nplots: false\n")
    trust = ("--config-dir", tmp_path / "own", "--trust-config-dir")
    out = tactorch("invert", f"recording={recording}", *trust, "experiment=x", "--cfg", "all").out
    assert "name: renamed" in out
    assert "plots: false" in out
    assert "leave out --trust-config-dir" in tactorch("invert", "resume=x", *trust).err


def test_settings_of_a_run_are_plain_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report or an evaluation of a foreign run does not show the reader's environment."""
    from tactorch.cli.resume import saved_options
    from tactorch.errors import FileError

    monkeypatch.setenv("A_SECRET", "do not show")
    (tmp_path / ".hydra").mkdir()
    file = tmp_path / ".hydra" / "config.yaml"
    file.write_text("seed: 3\nrun_dir: runs/${now:%Y}\n")
    assert saved_options("simulate", tmp_path).seed == 3
    for value in ("${oc.env:A_SECRET}", "${hydra:job.${oc.env:A_SECRET}}"):
        file.write_text(f"optimizer:\n  name: [tnc, '{value}']\n")
        with pytest.raises(FileError, match=r"optimizer\.name=.*A_SECRET.* is no plain value"):
            saved_options("invert", tmp_path)


def test_settings_of_a_run_may_refer_to_hydra(tactorch: Any) -> None:
    Path("trained/.hydra").mkdir(parents=True)
    settings = "run_dir: runs/${hydra:job.name}\ndata: {name: recognition, folder: nowhere}\n"
    Path("trained/.hydra/config.yaml").write_text(settings)
    done = tactorch("evaluate-model", "run=trained", "run_dir=out")
    assert done.status == 2
    assert "nowhere" in done.err
    assert "plain value" not in done.err
