"""Files and runs that exist are replaced with overwrite=true only."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

QUICK = ("method=map", "plots=false", "uncertainty=false", "optimizer.max_iterations=1")
CUBE = ("phantom=uniform_cube", "mesh=coarse", "press.faces=[z+]", "press.steps=1")


@pytest.fixture
def run(finished_run: Path) -> Path:
    """A copy of a finished run, in the current folder."""
    return Path(shutil.copytree(finished_run, "run"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_recording_is_replaced_on_demand_only(tactorch: Any) -> None:
    Path("a.h5").write_text("mine")
    refused = tactorch("simulate", *CUBE, "out=a.h5")
    assert refused.status == 2
    assert "out=a.h5 exists; give overwrite=true" in refused.err
    assert Path("a.h5").read_text() == "mine"
    assert tactorch("simulate", *CUBE, "out=a.h5", "overwrite=true").status == 0
    assert Path("a.h5").stat().st_size > 1000


def test_a_recording_in_another_folder_is_not_replaced(tactorch: Any) -> None:
    Path("mine").mkdir()
    Path("mine/recording.h5").write_text("mine")
    refused = tactorch("simulate", *CUBE, "run_dir=mine")
    assert refused.status == 2
    assert "mine/recording.h5 exists" in refused.err
    assert Path("mine/recording.h5").read_text() == "mine"


def test_a_run_is_not_replaced_by_another(tactorch: Any, run: Path, recording: Path) -> None:
    before = contents(run)
    refused = tactorch("invert", f"recording={recording}", f"run_dir={run}", *QUICK)
    assert refused.status == 2
    for word in (f"run_dir={run}", f"resume={run}", "overwrite=true"):
        assert word in refused.err
    assert contents(run) == before


def test_a_run_that_is_replaced_leaves_nothing(tactorch: Any, run: Path, recording: Path) -> None:
    for name in ("scores.json", "report.html"):
        (run / name).write_text("{}")
    (run / "notes.txt").write_text("mine")
    replaced = tactorch(
        "invert", f"recording={recording}", f"run_dir={run}", *QUICK, "overwrite=true"
    )
    assert replaced.status == 0, replaced.err
    assert not (run / "scores.json").exists()
    assert not (run / "report.html").exists()
    assert (run / "notes.txt").read_text() == "mine"
    assert (run / "invert.log").read_text().count("tactorch invert with") == 1


def test_a_run_is_not_replaced_by_another_command(tactorch: Any, run: Path) -> None:
    before = contents(run)
    refused = tactorch("simulate", *CUBE, f"run_dir={run}", "overwrite=true")
    assert refused.status == 2
    assert "holds a run of tactorch invert" in refused.err
    assert contents(run) == before


def test_a_folder_named_by_settings_is_not_replaced(tactorch: Any) -> None:
    words = ("simulate", *CUBE, "seed=3", "run_dir='runs/${seed}'")
    assert tactorch(*words).status == 0
    refused = tactorch(*words)
    assert refused.status == 2
    assert "run_dir=runs/3 holds the results" in refused.err


def test_a_copy_without_hidden_files_is_not_replaced(
    tactorch: Any, run: Path, recording: Path
) -> None:
    shutil.rmtree(run / ".hydra")
    before = contents(run)
    refused = tactorch("invert", f"recording={recording}", f"run_dir={run}", *QUICK)
    assert refused.status == 2
    assert f"run_dir={run} holds the results of an earlier run" in refused.err
    assert "resume" not in refused.err
    assert contents(run) == before


def test_a_refused_command_leaves_the_run_that_it_would_replace(tactorch: Any, run: Path) -> None:
    before = contents(run)
    refused = tactorch("invert", "recording=gone.h5", f"run_dir={run}", *QUICK, "overwrite=true")
    assert refused.status == 2
    assert "'gone.h5' is not a file" in refused.err
    assert contents(run) == before
    Path("dangling").symlink_to("nowhere")  # in the current folder, which is no run
    assert tactorch("invert", "recording=gone.h5", *QUICK, "overwrite=true").status == 2


def test_settings_that_are_only_shown_change_nothing(
    tactorch: Any, run: Path, recording: Path
) -> None:
    before = contents(run)
    words = (f"recording={recording}", f"run_dir={run}", *QUICK, "overwrite=true")
    assert tactorch("invert", *words, "--cfg", "job").status == 0
    assert contents(run) == before


def test_an_interrupted_command_leaves_the_run_that_it_would_replace(
    tactorch: Any, run: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(run)

    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tactorch.recording.Recording.load", interrupt)
    ended = tactorch("invert", f"recording={recording}", f"run_dir={run}", *QUICK, "overwrite=true")
    assert ended.status == 130
    assert contents(run) == before


def test_a_dataset_is_not_written_among_other_files(tactorch: Any, run: Path) -> None:
    before = contents(run)
    refused = tactorch("generate", f"out={run}", "dataset.count=1")
    assert refused.status == 2
    assert f"out={run} holds other files than those of a dataset" in refused.err
    assert contents(run) == before


@pytest.mark.slow
def test_a_sweep_is_not_replaced(tactorch: Any) -> None:
    words = ("simulate", "-m", *CUBE, "seed=1,2", "run_dir=sweep")
    assert tactorch(*words).status == 0
    refused = tactorch(*words)
    assert refused.status == 2
    assert "run_dir=sweep holds the results" in refused.err
    assert tactorch(*words, "overwrite=true").status == 0


def test_a_refused_continuation_keeps_the_settings(tactorch: Any, run: Path) -> None:
    before = contents(run / ".hydra")
    refused = tactorch("invert", f"resume={run}", "recording=gone.h5")
    assert refused.status == 2
    assert contents(run / ".hydra") == before


def test_a_report_is_not_replaced(tactorch: Any, run: Path) -> None:
    quick = ("report", run, "uncertainty=false")
    assert tactorch(*quick).status == 0
    before = (run / "report.html").read_bytes()
    refused = tactorch(*quick)
    assert refused.status == 2
    assert "report.html exists; give overwrite=true" in refused.err
    other = shutil.copytree(run, "other")
    compared = tactorch("report", run, other, "uncertainty=false", "run_dir=both")
    assert compared.status == 0, compared.err
    assert Path("both/comparison.html").is_file()
    assert (run / "report.html").read_bytes() == before


def test_scores_of_another_recording_are_not_replaced(
    tactorch: Any, run: Path, recording: Path
) -> None:
    for _ in range(2):
        assert tactorch("evaluate", run).status == 0
    refused = tactorch("evaluate", run, f"recording={shutil.copy(recording, 'copy.h5')}")
    assert refused.status == 2
    assert "scores.json exists" in refused.err


@pytest.mark.skipif(os.geteuid() == 0 and not Path("/proc").is_dir(), reason="needs /proc")
def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    tactorch: Any, run: Path
) -> None:
    Path("file").write_text("")
    for words in (("simulate", "out=file/a.h5"), ("report", run, "out=/proc/r.html")):
        refused = tactorch(*words)
        assert refused.status == 2
        assert "nothing can be written into" in refused.err
        assert "part" not in refused.err
    for words in (("simulate", f"out={run}"), ("report", run, f"out={run}")):
        assert f"out={run} is a folder; give the name of a file" in tactorch(*words).err


def test_paths_with_an_equals_sign_are_paths(tactorch: Any, run: Path, recording: Path) -> None:
    run.rename("a=b")
    assert tactorch("report", "./a=b", "uncertainty=false", "out=r.html").status == 0
    refused = tactorch("report", "./a=c")
    assert "neither a setting, KEY=VALUE, nor a path that exists" in refused.err
    shutil.copy(recording, "c=d.h5")
    refused = tactorch("invert", "c=d.h5")
    remedy = "recording='c=d.h5'"
    assert f'"{remedy}"' in refused.err
    assert tactorch("invert", remedy, *QUICK).status == 0
    for name in ("o'neil (1).h5", "run#2;b~.h5"):
        shutil.copy(recording, name)
        refused = tactorch("invert", f"recording={name}")
        (remedy,) = shlex.split(refused.err.rpartition("own quotes: ")[2].strip().removesuffix("."))
        assert tactorch("invert", remedy, *QUICK, f"run_dir=run {name[0]}").status == 0


def test_long_settings_and_settings_that_name_a_file_are_settings(tactorch: Any) -> None:
    centers = ",".join(f"[{i % 9 + 1}.5,{i // 9 + 1}.5,10]" for i in range(30))
    Path("seed=1").write_text("")
    done = tactorch(
        "simulate", f"press.patch_centers_mm=[{centers}]", "press.patch_radius_mm=1", "seed=1",
        "--cfg", "job",
    )  # fmt: skip
    assert done.status == 0, done.err


def test_ctrl_c_reaches_no_worker() -> None:
    """A worker that receives it while it imports packages prints a traceback."""
    code = """
import os, signal, time
from tactorch.processes import run_in_processes
def ignores(_): return signal.getsignal(signal.SIGINT) == signal.SIG_IGN
signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored in the background
print(list(run_in_processes(ignores, [0, 1], workers=2)))
print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[True, True]", "True"]
