"""The file as text: what it tells, what it leaves out and why, and how large it is."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, FileError, RecordingError
from tactorch.inverse import (
    Bounds,
    Composite,
    GaussNewton,
    Lump,
    NewtonCG,
    NoiseModel,
    NuisanceEstimate,
    NuisancePrior,
    Scaled,
    Settings,
    settings_from,
)
from tactorch.inverse.data.misfit import Huber
from tactorch.inverse.result.build import with_lumps
from tactorch.inverse.result.text import Fact, describe_lump
from tactorch.recording import Recording
from tactorch.report import Run, load_run, run_names, write_report
from tactorch.report.assessment import assess
from tactorch.report.content import RunReport, score_table


def page_of(run: Any, out: Path, **options: Any) -> str:
    return write_report([run], out / "report.html", **options).read_text(encoding="utf-8")


def test_it_is_small_and_alone(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    assert len(page) < 300_000
    assert "http://" not in page
    assert "https://" not in page
    assert " src=" not in page
    assert "default-src 'none'" in page


def test_a_thousand_elements_take_some_tens_of_kilobytes(run_folder: Path, tmp_path: Path) -> None:
    """So that a hundred thousand stay below 10 MB."""
    from tactorch.inverse import Reconstruction
    from tactorch.mesh import box_mesh

    mesh = box_mesh(10.0, 12)
    found = Reconstruction.load(run_folder / "reconstruction.h5")
    large = dataclasses.replace(
        found,
        mesh=mesh,
        youngs=np.geomspace(0.1, 1.0, mesh.n_tets),
        displacements=np.zeros((2, mesh.n_points, 3)),
        lumps=(),
    )
    run = dataclasses.replace(
        load_run(run_folder), result=large, recording=None, missing="it is left out"
    )
    least = len(page_of(dataclasses.replace(run, result=found), tmp_path))
    each = (len(page_of(run, tmp_path)) - least) / (mesh.n_tets - found.mesh.n_tets)
    assert each < 50


def with_lumps_of(told: RunReport, count: int) -> RunReport:
    result = dataclasses.replace(told.result, lumps=told.result.lumps[:count])
    return dataclasses.replace(told, run=dataclasses.replace(told.run, result=result))


def test_the_finding_stands_at_the_top(run_folder: Path) -> None:
    run = load_run(run_folder)
    told = with_lumps_of(assess(run), 1)
    assert told.lump is not None
    inclusion = told.lump.inclusion
    assert told.headline.startswith("A stiff lump, ")
    assert f"{inclusion.contrast:.2g} times" in told.headline
    # Pressed from above and from the side of x: the nearer of the two is how deep it lies.
    x, y, z = inclusion.center_mm
    depths = told.lump.depth_90_mm
    assert depths is not None
    assert told.facts[0] == Fact(
        "Depth",
        f"{min(10 - x, 10 - z):#.3g} mm",
        f"90 %: {depths[0]:.3g} to {depths[1]:.3g}; below the pressed side "
        f"{'x+' if x > z else 'z+'}; at ({x:.1f}, {y:.1f}, {z:.1f}) mm",
    )
    sure = next(fact for fact in told.facts if fact.label == "Probability")
    stated = told.lump.confidence
    assert stated is not None
    assert sure.value == "over 99.9 %" or sure.value == f"{100 * stated.probability:.3g} %"
    assert f"ratio of moduli {stated.contrast[0]:.2g} to {stated.contrast[1]:.2g}" in sure.note


def test_several_inclusions_are_counted_and_each_is_described(
    run_folder: Path, tmp_path: Path
) -> None:
    told = assess(load_run(run_folder), uncertainty=False)
    lump = told.result.lumps[0]
    other = dataclasses.replace(lump, size_mm=np.array([1.25, 2.0, 3.0]))

    def with_these(*lumps: Lump) -> RunReport:
        result = dataclasses.replace(told.result, lumps=lumps)
        return dataclasses.replace(told, run=dataclasses.replace(told.run, result=result))

    one, two = with_these(lump), with_these(lump, other)
    assert two.headline == "2 lumps"
    assert two.description == f"{one.headline}. {one.description}"
    assert two.others == [describe_lump(other)]
    assert "1.2 x 2 x 3 mm" in two.others[0]
    assert one.others == []


def at_its_bounds(run: Run) -> Run:
    result = dataclasses.replace(run.result, youngs=np.full_like(run.result.youngs, 100.0))
    assert run.recording is not None
    return dataclasses.replace(run, result=with_lumps(result, run.recording))


def test_an_alarm_stands_before_the_finding(run_folder: Path, tmp_path: Path) -> None:
    run = load_run(run_folder)
    page = page_of(at_its_bounds(run), tmp_path, uncertainty=False)
    assert (
        page.index("Do not trust this result")
        < page.index("100% of the map is")
        < page.index("<h1")
    )
    assert 'class="unreliable"' in page
    assert "Do not trust this result" not in page_of(run, tmp_path, uncertainty=False)


def test_warnings_are_those_of_the_summary(run_folder: Path) -> None:
    from tactorch.cli.outputs import describe_run, summarise

    run = at_its_bounds(load_run(run_folder))
    assert run.recording is not None
    summary = summarise(run.recording, run.result, "x")
    (reason,) = run.result.reasons
    assert summary["finding"]["reasons"] == [reason]
    assert describe_run(run.recording, run.result)[0] == f"Do not trust this result: {reason}"


def test_uncertainty_is_that_of_the_posterior(run_folder: Path) -> None:
    from tactorch.inverse import compute_posterior

    run = load_run(run_folder)
    steps: list[tuple[int, int]] = []
    assessment = assess(run, progress=lambda what, done, of: steps.append((done, of)))
    assert assessment.uncertainty is not None
    assert run.recording is not None
    settings = Settings(optimizer=GaussNewton(max_iterations=6))
    low, high = compute_posterior(run.recording, run.result, settings).interval(0.9)
    np.testing.assert_allclose(assessment.uncertainty.low, low)
    np.testing.assert_allclose(assessment.uncertainty.high, high)
    assert steps == [(k, 4) for k in range(5)]


@pytest.mark.parametrize("model_error", ["none", "discretisation"])
def test_misses_are_those_of_the_inversion(model_error: str, make_run: Any, tmp_path: Path) -> None:
    """All presses together, they are the misfit and the chi2 that it ended with."""
    settings = Settings(optimizer=GaussNewton(max_iterations=2), model_error=model_error)
    run = load_run(make_run(tmp_path / "run", settings))
    last = run.result.history[-1]
    assessment = [assess(run)]
    if model_error == "none":  # else they take solving the presses again
        assessment.append(assess(run, uncertainty=False))
    for one in assessment:
        squares = sum(np.nansum(fit.residual**2) for fit in one.fits)
        assert 0.5 * squares == pytest.approx(last["misfit"], rel=1e-4)
        mean = np.mean([fit.rms_deviations**2 for fit in one.fits])
        assert mean == pytest.approx(last["chi2"], rel=1e-4)


def test_no_uncertainty_is_told_at_a_bound(make_run: Any, tmp_path: Path) -> None:
    """There the interval is cut off, and would look as if the modulus were known."""
    settings = Settings(optimizer=GaussNewton(max_iterations=6), bounds=Bounds(0.1, 0.21))
    run = load_run(make_run(tmp_path / "run", settings))
    assessment = assess(run)
    assert assessment.uncertainty is not None
    above = run.result.youngs > 0.2099
    assert 0.05 < above.mean() < 0.95
    assert np.isnan(assessment.uncertainty.relative_half_width[above]).all()
    assert np.isfinite(
        assessment.uncertainty.relative_half_width[~assessment.uncertainty.at_bound]
    ).all()
    volumes = run.result.mesh.volumes
    share = volumes[assessment.uncertainty.at_bound].sum() / volumes.sum()
    told = [line for line in assessment.limitations if "factor of two" in line]
    assert f"{100 * share:.0f} %" in told[0]
    page_of(run, tmp_path)


def test_bounds_are_told_by_modulus_whatever_the_parameters(make_run: Any, tmp_path: Path) -> None:
    settings = Settings(optimizer=GaussNewton(max_iterations=2), parameterization=Scaled())
    run = load_run(make_run(tmp_path / "run", settings))
    assessment = assess(run)
    assert assessment.uncertainty is not None
    assert run.result.youngs.max() < 50.0  # of 100
    np.testing.assert_array_equal(assessment.uncertainty.at_bound, run.result.youngs < 0.00101)


def test_plain_misses_are_where_the_run_believes_the_sensor(make_run: Any, tmp_path: Path) -> None:
    settings = Settings(
        optimizer=GaussNewton(max_iterations=3), model_error="none",
        nuisance=NuisancePrior(translation_mm=0.1, rotation_rad=0.01), noise=NoiseModel(mm=0.02),
    )  # fmt: skip
    run = load_run(make_run(tmp_path / "run", settings))
    plain = assess(run, uncertainty=False).fits
    assert sum(0.5 * np.nansum(fit.residual**2) for fit in plain) == pytest.approx(
        run.result.history[-1]["misfit"], rel=1e-4
    )
    for fit in plain:
        np.testing.assert_allclose(fit.deviations, fit.residual / 0.02)


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("not enough memory: 9 GB")])
def test_a_posterior_that_does_not_fit_the_memory_costs_no_report(
    error: Exception, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("tactorch.report.assessment.posterior_at", fail)
    assessment = assess(load_run(run_folder))
    assert assessment.uncertainty is None
    assert "memory" in assessment.missing
    assert len(assessment.fits) == 2


def test_a_nuisance_whose_deviation_was_not_computed_is_not_said_to_be_unknown(
    run_folder: Path,
) -> None:
    run = load_run(run_folder)
    for deviation, words in ((np.nan, "was not computed"), (0.02, "hardly determine"), (0.001, "")):
        estimate = NuisanceEstimate(np.array([0.4]), np.array([deviation]), 0.02)
        found = dataclasses.replace(run.result, nuisance={"poisson": estimate})
        report = assess(run, uncertainty=False)
        told = dataclasses.replace(report, run=dataclasses.replace(run, result=found)).limitations
        named = [line for line in told if "poisson" in line]
        assert [words in line for line in named] == [True] * bool(words)


def test_references_that_differ_have_their_own_columns(run_folder: Path) -> None:
    first = load_run(run_folder)
    assert first.recording is not None
    maps = [np.full(first.recording.mesh.n_tets, mpa) for mpa in (0.2, 0.3)]
    runs = [
        dataclasses.replace(
            first, name=name, recording=dataclasses.replace(first.recording, reference=youngs)
        )
        for name, youngs in zip(("a", "b"), maps, strict=True)
    ]
    assert list(score_table(runs).header) == ["", "a", "b", "reference of a", "reference of b"]
    same = score_table([runs[0], dataclasses.replace(runs[0], name="c")])
    assert list(same.header) == ["", "a", "c", "reference"]


def test_without_its_recording_it_tells_what_is_left(run_folder: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(run_folder, tmp_path / "run"))
    summary = json.loads((folder / "summary.json").read_text())
    summary["recording"] = str(tmp_path / "gone.h5")
    (folder / "summary.json").write_text(json.dumps(summary))
    run = load_run(folder)
    assert run.recording is None
    assert "gone.h5" in run.missing
    page = page_of(run, tmp_path)
    assert "the recording is missing" in page
    assert 'id="presses"' not in page
    assert "A stiff lump" in page or " lumps" in page


def test_a_recording_that_is_given_has_to_fit(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nowhere\.h5"):
        load_run(run_folder, recording=tmp_path / "nowhere.h5")
    run = load_run(run_folder)
    assert run.recording is not None
    run.recording.select([0]).save(tmp_path / "fewer.h5")
    with pytest.raises(RecordingError, match="has 1 presses, the result 2"):
        load_run(run_folder, recording=tmp_path / "fewer.h5")


def test_an_unfinished_run_is_refused(tmp_path: Path, run_folder: Path) -> None:
    with pytest.raises(FileError, match="run not found"):
        load_run(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="finished `tactorch invert`"):
        load_run(tmp_path / "empty")
    folder = Path(shutil.copytree(run_folder, tmp_path / "spoilt"))
    (folder / "summary.json").write_text("[1, 2")
    with pytest.raises(FileError, match=r"summary\.json' cannot be read"):
        load_run(folder)


def test_colours_and_runs_are_checked(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="colours=jet"):
        write_report([load_run(run_folder)], tmp_path / "x.html", colours="jet")
    with pytest.raises(ConfigError, match="at least one"):
        write_report([], tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()


def test_text_is_escaped(run_folder: Path, tmp_path: Path) -> None:
    """A path may hold anything but a slash."""
    name = "<b>\"'&$title"
    folder = Path(shutil.copytree(run_folder, tmp_path / name))
    (folder / "invert.log").write_text("<script>alert(1)</script>")
    page = page_of(load_run(folder), tmp_path, uncertainty=False)
    assert "<b>" not in page
    assert "&lt;b&gt;&#34;&#39;&amp;$title" in page
    assert page.count("<script") == 2
    assert "&lt;script&gt;alert(1)" in page


def test_names_are_short_and_differ() -> None:
    assert run_names([Path("/a/runs/x")]) == ["x"]
    assert run_names([Path("/a/x"), Path("/b/x"), Path("/b/y")]) == ["a/x", "b/x", "b/y"]


@pytest.mark.parametrize(
    "settings",
    [
        Settings(),
        Settings(
            optimizer=NewtonCG(max_iterations=3),
            parameterization=Scaled(),
            regularization=Composite(parts={"log_jumps": {"edge": 0.2}, "matern": 0.5}, weight=2.0),
            bounds=Bounds(0.01, 5.0),
            noise=NoiseModel(mm=0.01),
            misfit=Huber(),
            nuisance=NuisancePrior(poisson=0.02),
        ),
    ],
)
def test_settings_come_back_from_a_result(settings: Settings) -> None:
    config = json.loads(json.dumps({"settings": to_mapping(settings)}))
    assert settings_from(config) == settings


def test_settings_that_are_not_all_told_are_refused() -> None:
    config = {"settings": to_mapping(Settings())}
    settings_from(config)
    config["settings"]["regularization"]["mean_mpa"] = "float64 array [5], sha256 abc..."
    with pytest.raises(ConfigError, match="a map that the result does not store"):
        settings_from(config)
    with pytest.raises(ConfigError, match="settings of the result cannot be read"):
        settings_from({"settings": {"optimizer": "tnc", "warp": 9}, "optimizer": {"name": "tnc"}})


def test_a_report_goes_without_what_cannot_be_told(run_folder: Path, tmp_path: Path) -> None:
    run = load_run(run_folder)
    config = json.loads(json.dumps(run.result.config))
    config["settings"]["regularization"]["mean_mpa"] = "float64 array [135], sha256 abc..."
    page = page_of(
        dataclasses.replace(run, result=dataclasses.replace(run.result, config=config)), tmp_path
    )
    assert "Omitted: credibility and uncertainty (the mean of the prior is a map" in page


def test_the_best_score_is_marked(run_folder: Path) -> None:
    run = load_run(run_folder)
    assert run.recording is not None
    assert run.recording.truth is not None
    true = dataclasses.replace(run.result, youngs=run.recording.truth)
    best = dataclasses.replace(run, name="right", result=true)
    table = score_table([run, best])
    (row,) = (k for k, cells in enumerate(table.rows) if cells[0].startswith("RMSE"))
    assert table.best[row] == {2}
    assert not any(score_table([run]).best.values())
    # Scores against different truths cannot be compared.
    recording = dataclasses.replace(run.recording, truth=run.recording.truth * 1.1)
    table = score_table([run, dataclasses.replace(best, recording=recording)])
    assert not table.best
    assert "the truths differ" in table.caption


def test_the_best_score_is_marked_on_the_page(run_folder: Path, tmp_path: Path) -> None:
    run = load_run(run_folder)
    assert run.recording is not None
    assert run.recording.truth is not None
    true = dataclasses.replace(run.result, youngs=run.recording.truth)
    runs = [run, dataclasses.replace(run, name="right", result=true)]
    page = write_report(runs, tmp_path / "report.html", uncertainty=False).read_text()
    row = page.split("RMSE of the modulus")[1].split("</tr>")[0]
    assert row.count('class="best"') == row.count(">best</span>") == 1
    assert row.index("</td>") < row.index('class="best"')


def test_a_recording_without_a_truth_has_no_scores(run_folder: Path, tmp_path: Path) -> None:
    run = load_run(run_folder)
    assert isinstance(run.recording, Recording)
    blind = dataclasses.replace(run, recording=dataclasses.replace(run.recording, truth=None))
    page = page_of(blind, tmp_path, uncertainty=False)
    assert "no truth to score" in page
    assert "Correlation" not in page
