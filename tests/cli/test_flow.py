"""Import, invert, evaluate, simulate, demo: the forms that are promised, and what they leave."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.cli import app
from tactorch.cli.starting import STARTED
from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording

QUICK = ("plots=false", "method=map", "optimizer.max_iterations=2")
TINY = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null", "press.steps=1")
NUMBERS = ("seconds", "iterations", "misfit", "rmse_mpa", "pearson", "ssim", "psnr")


def summary_of(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "summary.json").read_text())
    assert isinstance(found, dict)
    return found


def test_import_makes_a_recording_of_a_published_case(
    tactorch: Any, published: Path, recording_file: Path
) -> None:
    done = tactorch("import", "format=published", f"path={published}", "out=sub/case.h5")
    assert done.status == 0, done.err
    got, expected = Recording.load("sub/case.h5"), Recording.load(recording_file)
    assert got.mesh.content_hash() == expected.mesh.content_hash()
    np.testing.assert_allclose(got.truth, expected.truth)
    for one, other in zip(got.presses, expected.presses, strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, atol=1e-12)
        np.testing.assert_allclose(one.springs, other.springs)
    assert "2, force" in done.out
    assert "case.h5" in done.out


def test_unknowns_are_estimated_and_said(tactorch: Any, recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    done = tactorch(
        "invert", f"recording={recording}", f"run_dir={folder}", "nuisance.poisson=0.02",
        "nuisance.rest_scale=0.1", *QUICK,
    )  # fmt: skip
    assert done.status == 0, done.err
    found = summary_of(folder)["nuisance"]
    assert set(found) == {"poisson", "rest_scale"}
    assert len(found["rest_scale"]["value"]) == len(found["rest_scale"]["deviation"]) == 3
    assert f"poisson {found['poisson']['value'][0]:.4g} +- " in (folder / "summary.txt").read_text()
    again = tactorch("invert", f"resume={folder}", "nuisance.poisson=null", *QUICK)
    assert again.status == 2
    assert "belongs to another" in again.err


@pytest.mark.parametrize(
    ("settings", "element"),
    [
        (("mesh.fine_relative=0.3",), "tet10"),
        (("mesh.fine_relative=0.3", "fine_element=tet4"), "tet4"),
        ((), "tet4"),
        (("element=tet10",), "tet10"),
    ],
)
def test_presses_on_a_separate_mesh_have_quadratic_elements(
    tactorch: Any, settings: tuple[str, ...], element: str
) -> None:
    done = tactorch("simulate", *TINY, *settings, "out=made.h5")
    assert done.status == 0, done.err
    provenance = Recording.load("made.h5").provenance
    assert provenance["element"] == element
    separate = "mesh.fine_relative=0.3" in settings
    assert provenance["mesh"]["fine_relative"] == (0.3 if separate else None)
    at_points = separate and element == "tet10"
    assert provenance["modulus"] == ("at quadrature points" if at_points else "per element")
    assert provenance["inverse_crime"] == (len(settings) == 0 or settings[0] == "element=tet10")


@pytest.mark.parametrize(
    ("optimizer", "brief"),
    [
        ("gauss_newton", "optimizer.max_iterations=2"),
        ("tnc", "optimizer.max_evaluations=4"),
        ("lbfgs", "optimizer.max_iterations=2"),
    ],
)
def test_invert_leaves_map_and_summary(
    tactorch: Any, recording: Path, tmp_path: Path, optimizer: str, brief: str
) -> None:
    folder = tmp_path / "run"
    done = tactorch(
        "invert", f"recording={recording}", f"optimizer={optimizer}", f"run_dir={folder}",
        brief, "plots=false", "method=map",
    )  # fmt: skip
    assert done.status == 0, done.err
    summary = summary_of(folder)
    assert all(np.isfinite(summary[name]) for name in NUMBERS)
    assert isinstance(summary["stop_reason"], str)
    assert summary["optimizer"] == optimizer
    result = Reconstruction.load(folder / "reconstruction.h5")
    assert summary["misfit"] == result.misfit_mm2 < result.history[0]["misfit"]
    names = {path.name for path in folder.iterdir()}
    assert {"reconstruction.vtu", "summary.txt", "invert.log", ".hydra", "checkpoint.npz"} <= names
    assert summary["stop_reason"] in (folder / "summary.txt").read_text()


@pytest.mark.parametrize("lower", [0.001, 0.3])
def test_a_map_at_its_bounds_is_told(
    tactorch: Any, recording: Path, tmp_path: Path, lower: float
) -> None:
    """The body has 0.2 MPa, so that a bound above it holds nearly all of the map."""
    done = tactorch(
        "invert", f"recording={recording}", f"run_dir={tmp_path}", f"bounds.lower={lower}",
        "initialization.start_mpa=0.4", "optimizer.max_iterations=5", "plots=false", "method=map",
    )  # fmt: skip
    assert done.status == 0, done.err
    content = (tmp_path / "summary.txt").read_text()
    assert ("Do not trust" in content) == (lower == 0.3)
    assert (summary_of(tmp_path)["volume_at_bounds"] > 0.2) == (lower == 0.3)
    assert len(summary_of(tmp_path)["finding"]["reasons"]) == (lower == 0.3)


def test_run_folder_tells_how_it_came_about(tactorch: Any, recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    start = "initialization.start_mpa=0.25"
    tactorch("invert", f"recording={recording}", f"run_dir={folder}", start, *QUICK)
    config = (folder / ".hydra" / "config.yaml").read_text()
    assert "start_mpa: 0.25" in config
    assert "max_trials: 12" in config  # what was not typed too
    log = (folder / "invert.log").read_text()
    assert "iteration    1" in log
    assert "numpy" in log
    recorded = summary_of(folder)["config"]
    assert recorded["versions"]["numpy"] == np.__version__
    assert recorded["recording"]["seed"] == 0
    assert summary_of(folder)["recording"] == str(recording)


@pytest.mark.slow
def test_pictures_are_drawn_with_other_runs_beside(
    tactorch: Any, recording: Path, tmp_path: Path
) -> None:
    run = ("invert", f"recording={recording}", "optimizer.max_iterations=1", "method=map")
    assert tactorch(*run, "run_dir=a/0", "plots=false").status == 0
    # Runs of one optimizer in folders of one name still are curves of their own.
    shutil.copytree("a/0", "b/0")
    done = tactorch(*run, "run_dir=c", "compare=[a/0,b/0]")
    assert done.status == 0, done.err
    for name in ("slices.png", "convergence.png"):
        assert Path("c", name).read_bytes().startswith(b"\x89PNG")
        assert name in done.out


def test_evaluate_prints_and_writes_scores(tactorch: Any, recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    tactorch("invert", f"recording={recording}", f"run_dir={folder}", *QUICK)
    done = tactorch("evaluate", f"run={folder}")
    assert done.status == 0, done.err
    scores = json.loads((folder / "scores.json").read_text())["reconstruction"]
    summary = summary_of(folder)
    assert scores["pearson"] == summary["pearson"]
    assert f"{scores['pearson']:.4g}" in done.out
    elsewhere = tactorch(
        "evaluate", f"run={folder / 'reconstruction.h5'}", f"recording={recording}", "out=s.json"
    )
    assert elsewhere.status == 0, elsewhere.err
    assert json.loads(Path("s.json").read_text())["reconstruction"] == scores


def test_simulate_obeys_overrides(tactorch: Any) -> None:
    done = tactorch(
        "simulate", *TINY, "phantom=cube_box", "phantom.inclusion_mpa=2", "press=top", "seed=7",
        "snr_db=30", "material=mooney_rivlin", "solver=superlu", "out=box.h5", "run_dir=here",
    )  # fmt: skip
    assert done.status == 0, done.err
    made = Recording.load("box.h5")
    assert made.provenance["phantom"]["inclusions"][0]["youngs_mpa"] == 2
    assert [press.name for press in made.presses] == ["z+, 20 kPa"]
    assert made.material.name == "mooney_rivlin"
    assert made.provenance["seed"] == 7
    assert made.provenance["versions"]["numpy"] == np.__version__
    assert "Reoriented" not in done.out
    assert "seed: 7" in Path("here/.hydra/config.yaml").read_text()


def test_each_job_of_a_sweep_has_its_folder(tactorch: Any) -> None:
    done = tactorch(
        "simulate", "-m", *TINY, "press=top", "seed=1,2", "run_dir=sweep", "out='seed-${seed}.h5'"
    )
    assert done.status == 0, done.err
    assert Path("sweep/seed-2/.hydra/config.yaml").is_file()
    one, two = (Recording.load(f"seed-{seed}.h5") for seed in (1, 2))
    assert (one.provenance["seed"], two.provenance["seed"]) == (1, 2)
    assert not np.array_equal(one.presses[0].displacement, two.presses[0].displacement)


def test_failed_job_does_not_stop_a_sweep(tactorch: Any) -> None:
    done = tactorch("simulate", "-m", *TINY, "press=top", "press.p_max_mpa=-1,0.01", "run_dir=s")
    assert done.status == 2
    assert "p_max_mpa=-1" in done.err
    assert "p_max_mpa=-1" in Path("s/press.p_max_mpa-1/simulate.log").read_text()
    assert Path("s/press.p_max_mpa-0.01/recording.h5").is_file()


def test_jobs_of_a_sweep_do_not_overwrite_each_other(tactorch: Any) -> None:
    done = tactorch("simulate", "-m", *TINY, "press=top", "seed=1,2", "out=x.h5", "run_dir=s")
    assert done.status == 2
    assert "more than one job" in done.err
    assert Recording.load("x.h5").provenance["seed"] == 1


def test_demo_simulates_and_inverts(tactorch: Any) -> None:
    done = tactorch("demo", *TINY, "press=top", *QUICK)
    assert done.status == 0, done.err
    assert "Simulated: " in done.out
    (run,) = Path("outputs/demo").iterdir()
    assert summary_of(run)["recording"] == str(run.resolve() / "recording.h5")
    assert Recording.load(run / "recording.h5").truth is not None


@pytest.mark.slow
def test_demo_runs_on_a_published_case(tactorch: Any, published: Path) -> None:
    quick = (*QUICK, "method=auto")
    done = tactorch("demo", "source=published", f"path={published}", "run_dir=d", *quick)
    assert done.status == 0, done.err
    summary = summary_of(Path("d"))
    assert summary["elements"] == 40
    assert summary["finding"] == json.loads(Path("d/finding.json").read_text())


def test_second_run_in_a_folder_leaves_nothing_of_the_first(tactorch: Any, recording: Path) -> None:
    Path("run").mkdir()
    Path("run/slices.png").write_bytes(b"of an earlier run")
    Path("run/mine.txt").write_text("not of tactorch")
    run = ("invert", f"recording={recording}", "run_dir=run", *QUICK)
    assert tactorch(*run, "bounds.lower=0.01").status == 0
    assert not Path("run/slices.png").exists()
    assert Path("run/mine.txt").is_file()
    assert Path("run/summary.json").is_file()


def test_wrong_setting_spares_the_results_in_the_folder(tactorch: Any, recording: Path) -> None:
    run = ("invert", f"recording={recording}", "run_dir=run", *QUICK)
    tactorch(*run)
    before = Path("run/summary.json").read_bytes()
    assert tactorch(*run, "bounds.lower=200").status == 2
    assert Path("run/summary.json").read_bytes() == before


def test_time_limit_keeps_the_best_map(tactorch: Any, recording: Path) -> None:
    done = tactorch(
        "invert", f"recording={recording}", "run_dir=run", "plots=false", "method=map",
        "max_seconds=1e-6",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert summary_of(Path("run"))["stop_reason"] == "time limit reached"


def test_path_with_odd_characters_can_be_given_in_quotes(
    tactorch: Any, recording: Path, tmp_path: Path
) -> None:
    odd = tmp_path / "a=b (1), c.h5"
    recording.rename(odd)
    refused = tactorch("invert", f"recording={odd}", "run_dir=run", *QUICK)
    assert refused.status == 2
    assert f"recording='{odd}'" in refused.err
    done = tactorch("invert", f"recording='{odd}'", "run_dir=run", *QUICK)
    assert done.status == 0, done.err


def test_a_new_inversion_takes_away_what_was_made_of_the_old_one(tmp_path: Path) -> None:
    from tactorch.cli.outputs import remove_results

    for name in ("finding.txt", "finding.json", "report.html", "summary.json", "mine.txt"):
        (tmp_path / name).write_text("old")
    remove_results(tmp_path, None)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_lines_are_shown_until_the_options_of_a_command_are_made(
    tactorch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[bool] = []

    def build(command: str, cfg: Any) -> Any:
        started.append(STARTED.is_set())
        raise ConfigError("not made")

    STARTED.clear()
    monkeypatch.setattr(app, "build_options", build)
    assert tactorch("simulate").status == 2
    assert started == [False]
    assert STARTED.is_set()
