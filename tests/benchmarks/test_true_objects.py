"""The benchmark of analytic objects: scores of known answers, truth meshes, and a tiny case."""

import json
import logging
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.fem import ELEMENTS, Discretisation
from tactorch.inverse import Settings
from tactorch.mesh import Box, Sphere, tetrahedralize
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import Recording

NAME = "true_objects"


def _score(benchmark: ModuleType, name: str, youngs_at: Callable[..., Any], **answer: Any) -> Any:
    import true_cases

    body = true_cases.OBJECTS[name]()
    truth = benchmark.Truth.of(body)
    return benchmark.score(truth, benchmark.Answer(youngs_at, 1.0, **answer)), body


@pytest.mark.parametrize(
    "name",
    ["ball", "soft_ball", "two_balls", "layers_ball", "dome", "l_shape", "plate", "two_moduli"],
)
def test_the_object_itself_scores_as_perfect(benchmark: ModuleType, name: str) -> None:
    import true_cases

    phantom = true_cases.OBJECTS[name]().phantom
    scores, _ = _score(benchmark, name, phantom.youngs_at)
    assert scores["r"] == pytest.approx(1.0)
    assert scores["contrast"] == pytest.approx(1.0)
    assert scores["rmse_log"] == 0.0
    assert scores["dice"] == 1.0
    assert scores["position_mm"] == pytest.approx(0.0, abs=1e-9)
    assert scores["size_ratio"] == pytest.approx(1.0)
    assert scores["covered_90_inside"] is None


def test_decisions_against_the_reduced_model_are_listed(benchmark: ModuleType) -> None:
    log, decisions = logging.getLogger("test of decisions"), benchmark.Decisions()
    log.addHandler(decisions)
    log.setLevel(logging.DEBUG)
    log.propagate = False
    for what, chi2, gain in (("a ball", 1.02, 40.0), ("a ring", 1.05, 16.0), ("smooth", 1.06, 9.0)):
        log.debug("proposal: %s, chi2 %.4g, log-evidence %+.4g", what, chi2, gain)
    fits = ("a ball", 1.02, 34.0), ("a ring", 0.99, 117.3), ("smooth", 1.2, -8.0)
    for what, chi2, gain in fits:
        log.info("%s: chi2 %.4g, log-evidence %+.4g", what, chi2, gain)
    log.debug("proposal: %s, chi2 %.4g, log-evidence %+.4g", "a ball", 1.0, 4.0)
    log.info("%s: chi2 %.4g, log-evidence %+.4g", "a ball", 1.0, 5.0)  # as predicted
    log.info("final fit: chi2 %.4g", 0.98)
    decisions.finish()
    log.removeHandler(decisions)
    assert decisions.found == [
        "refused: smooth (+9, -8)", "preferred: a ring (+16, +117) to a ball (+40, +34)",
    ]  # fmt: skip
    rows = benchmark._decisions({"torus": {"decisions": decisions.found}, "ball": {}})
    assert rows[-1] == "| torus | preferred: a ring (+16, +117) to a ball (+40, +34) |"
    assert benchmark._decisions({"ball": {}}) == []


def test_a_uniform_map_has_no_contrast(benchmark: ModuleType) -> None:
    scores, _ = _score(benchmark, "ball", lambda points: np.full(len(points), 0.3), lumps=())
    assert scores["r"] is None
    assert scores["contrast"] == pytest.approx(0.0, abs=1e-12)
    assert scores["dice"] == 0.0
    assert scores["position_mm"] is None
    assert scores["size_ratio"] is None
    assert scores["lumps_reported"] == 0


def test_scores_of_a_ball_at_the_wrong_place(benchmark: ModuleType) -> None:
    """0.5 mm off, 1.5 times the radius, half of the contrast; intervals are those of a normal."""

    def youngs(points: np.ndarray) -> np.ndarray:
        inside = Sphere((5.5, 5.0, 6.0), 3.0).contains(points)
        return np.where(inside, 0.6, 0.2)

    def deviation(points: np.ndarray) -> np.ndarray:
        return np.full(len(points), np.log(1.0 / 0.6) / 1.0)

    lump = benchmark.FoundLump((5.0, 5.0, 6.7), 2.0, 1.0)
    scores, _ = _score(benchmark, "ball", youngs, log_deviation_at=deviation, lumps=(lump,))
    assert scores["contrast"] == pytest.approx(0.5)
    assert scores["modulus_inside_mpa"] == pytest.approx(0.6)
    assert scores["position_mm"] == pytest.approx(0.5, abs=0.02)
    assert scores["reported_position_mm"] == pytest.approx(0.7, abs=0.02)
    assert scores["size_ratio"] == pytest.approx(1.5, rel=0.01)
    assert scores["covered_50_inside"] == 0.0  # one deviation off; the interval has 0.67
    assert scores["covered_90_inside"] == 1.0
    assert scores["covered_90_outside"] < 1.0


def test_the_segmentation_has_no_lump_without_contrast(benchmark: ModuleType) -> None:
    values = np.full(10_000, 0.2)
    values[:20] = 50.0  # too few to be a lump
    mask, contrast = benchmark.segment(values)
    assert not mask.any()
    assert contrast == 1.0
    values[:100] = 0.05
    mask, contrast = benchmark.segment(values)
    assert mask.sum() == 100
    assert contrast == pytest.approx(0.25)


@pytest.mark.slow
def test_refinement_conforms_and_follows_the_surface(benchmark: ModuleType) -> None:
    import true_meshes

    phantom = make_phantom("cube_sphere", depth=0.4, radius=0.2)
    ball = phantom.inclusions[0].shape
    coarse = tetrahedralize(*phantom.body.surface(), 5.0, inner=[ball.surface(12)])
    mesh = true_meshes.refine(phantom, coarse, lambda p: np.where(p[:, 2] > 8.5, 1.2, 9.0))
    finer = true_meshes.refine_everywhere(phantom, mesh)
    exact = 4.0 / 3.0 * np.pi * 8.0
    for one in (mesh, finer):
        assert one.mesh.volumes.min() > 0
        # A mesh that did not conform would have more faces of one element only.
        assert one.mesh.surface.areas.sum() == pytest.approx(600.0, rel=1e-3)
        assert one.mesh.volumes.sum() == pytest.approx(1000.0, rel=1e-3)
        first, second = one.mesh.adjacency.pairs.T
        between = one.labels[first] != one.labels[second]
        shared = [
            np.intersect1d(one.mesh.tets[i], one.mesh.tets[j])
            for i, j in one.mesh.adjacency.pairs[between]
        ]
        nodes = np.unique(np.concatenate(shared))
        distances = np.abs(ball.signed_distance(one.mesh.points[nodes]))
        assert np.quantile(distances, 0.9) < 0.02
    lacking = [1.0 - one.mesh.volumes[one.labels == 1].sum() / exact for one in (mesh, finer)]
    assert 0.0 < lacking[1] < 0.7 * lacking[0] < 0.1
    assert finer.mesh.n_tets > 2 * mesh.mesh.n_tets
    high = mesh.mesh.centroids[:, 2] > 8.5
    ends = mesh.mesh.points[mesh.mesh.edges[mesh.mesh.tet_edges[high]]]
    assert np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2).max() <= 1.2 + 1e-12


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_a_finger_has_its_total_and_its_moment_on_any_element(
    benchmark: ModuleType, element: str
) -> None:
    import true_cases

    mesh = make_phantom("uniform_cube").mesh(1.6)
    contact = true_cases.Contact("finger", "", (4.0, 5.0, 10.0), (0.0, 0.0, -1.0), 3.0)
    discretisation = Discretisation(mesh, ELEMENTS[element])
    forces = contact.unit_forces(discretisation)
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, -4.5 * np.pi], atol=1e-9)
    center = forces[:, 2] @ discretisation.positions / forces[:, 2].sum()
    np.testing.assert_allclose(center, [4.0, 5.0, 10.0], atol=0.02)
    observed = mesh.points[contact.observed(mesh)]
    assert (np.abs(observed[:, 2] - 10.0) < 1e-9).all()
    assert np.linalg.norm(observed[:, :2] - [4.0, 5.0], axis=1).max() <= 3.0


@pytest.fixture
def tiny(benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The benchmark with a coarse object, and a patch and a finger on it."""
    import true_cases

    phantom = Phantom(Box((5.0,) * 3, (10.0,) * 3), [(Box((5.0, 5.0, 6.0), (4.0,) * 3), 1.0)])
    body = true_cases.Body(phantom, (0,), 5.0, truth_edge_mm=5.0, interface_mm=5.0)
    place = (5.0, 5.0, 10.0)
    sites = (
        true_cases.Contact("side", "x+"),
        true_cases.Contact("patch", "z+", place, radius_mm=3.0),
    )
    finger = true_cases.Contact("finger", "", place, (0.0, 0.0, -1.0), 4.0)
    presses = {
        "both": true_cases.Presses("both", sites, (0.01, 0.02)),
        "patch": true_cases.Presses("patch", sites[1:], (0.02,)),
        "finger": true_cases.Presses("finger", (finger,), (0.02,), "z-", refined_mm=3.0),
    }
    monkeypatch.setattr(true_cases, "OBJECTS", {"tiny": lambda: body})
    monkeypatch.setattr(true_cases, "LUMP_PER_RADIUS", 2.5)
    monkeypatch.setattr(true_cases, "CREASE_PER_SIZE", 0.3)
    monkeypatch.setattr(true_cases, "RECORDED_PER_RADIUS", 1.0)
    monkeypatch.setattr(true_cases, "RIM_PER_RADIUS", 1.0)
    monkeypatch.setattr(true_cases, "PRESSES", presses)
    cases = (
        true_cases.Case("tiny", "both", 40.0),
        true_cases.Case("tiny", "both", 30.0, "forces", held_out=True),
        true_cases.Case("tiny", "patch", 40.0),
        true_cases.Case("tiny", "patch", 40.0, "places", held_out=True),
        true_cases.Case("tiny", "finger", 40.0, held_out=True),
    )
    monkeypatch.setattr(benchmark, "CASES", cases)
    monkeypatch.setattr(benchmark, "EMPTY_CASES", ())
    return benchmark


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of solutions of the tiny object, each solved once."""
    return tmp_path_factory.mktemp("solutions")


@pytest.mark.slow
def test_a_tiny_case_from_end_to_end(
    tiny: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--cache", str(tmp_path), "--only", "tiny-both-40db"]
    tiny.main([*arguments, "--settings", "noise.relative=0.02", "element=tet4"])
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    scores = result["cases"]["tiny-both-40db"]
    for key in ("r", "contrast", "dice", "covered_90_inside", "seconds", "chi2"):
        assert np.isfinite(scores[key])
    assert result["median"]["contrast"] == scores["contrast"]
    assert result["failed"] == 0
    assert len(list(tmp_path.iterdir())) == 1


@pytest.fixture
def received(tiny: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """The recordings that the default method gets, which answers with a uniform map."""
    recordings: list[Recording] = []

    def method(recording: Recording, settings: Settings) -> Any:
        recordings.append(recording)
        return tiny.Answer(lambda points: np.full(len(points), 0.2), 0.0)

    monkeypatch.setitem(tiny.METHODS, "default", method)
    return recordings


def test_no_truth_reaches_a_method_and_noise_is_as_stated(
    tiny: ModuleType, received: list[Recording], cache: Path
) -> None:
    tiny.main(["--set", "all", "--cache", str(cache)])
    exact = [case.solution.recording(cache) for case in tiny.CASES]
    assert len(received) == len(tiny.CASES)
    for case, recording, clean in zip(tiny.CASES, received, exact, strict=True):
        assert recording.truth is None
        assert recording.reference is None
        assert recording.provenance == {}
        for noisy, press in zip(recording.presses, clean.presses, strict=True):
            errors = (noisy.displacement - press.displacement)[press.observed]
            signal = np.sqrt(np.mean(press.displacement[press.observed] ** 2))
            assert noisy.noise_mm == pytest.approx(signal * 10 ** (-case.snr_db / 20))
            assert np.std(errors) == pytest.approx(noisy.noise_mm, rel=0.7)
    totals = [
        np.array([press.forces.sum() for press in recording.presses])
        for recording in (*received[:2], exact[0])
    ]
    np.testing.assert_array_equal(totals[0], totals[2])
    assert 0.01 < np.std(totals[1] / totals[2]) < 0.15
    right, wrong = received[2].presses[0], received[3].presses[0]
    np.testing.assert_array_equal(right.forces, wrong.forces)
    np.testing.assert_array_equal(right.observed, wrong.observed)
    change = (exact[3].presses[0].displacement - exact[2].presses[0].displacement)[right.observed]
    size = np.sqrt(np.mean(right.displacement[right.observed] ** 2))
    assert 1e-4 < np.sqrt(np.mean(change**2)) / size < 0.3
    # Where the fingers act, the object stands on its held side.
    assert received[4].presses[0].fixed.any()


def test_the_mesh_of_the_solution_may_be_finer(
    tiny: ModuleType, received: list[Recording], cache: Path
) -> None:
    arguments = ["--cache", str(cache), "--only", "tiny-both-40db"]
    tiny.main(arguments)
    tiny.main([*arguments, "--refined", "0.7"])
    coarse, fine = received
    assert fine.mesh.n_tets > 2 * coarse.mesh.n_tets
    for one, other in zip(fine.presses, coarse.presses, strict=True):
        known = other.observed.any(axis=1)
        points = coarse.mesh.points[known]
        index = cKDTree(fine.mesh.points).query(points)[1]
        np.testing.assert_array_equal(one.displacement[index], other.displacement[known])
        np.testing.assert_allclose(one.forces.sum(axis=0), other.forces.sum(axis=0))
        assert one.observed.sum() == other.observed.sum()  # no data were added


def test_patches_have_fine_rims_each_on_a_mesh_of_its_own(benchmark: ModuleType) -> None:
    import true_cases

    patches = true_cases.PRESSES["patches"]
    parts = patches.parts
    assert [part.contacts for part in parts] == [(contact,) for contact in patches.contacts]
    assert true_cases.PRESSES["sides"].parts == (true_cases.PRESSES["sides"],)
    points = np.array([[7.0, 5.0, 10.0], [5.0, 5.0, 10.0], [5.0, 5.0, 5.0]])
    (part,) = (part for part in parts if part.contacts[0].center_mm == (5.0, 5.0, 10.0))
    sizes = part.rims(points)
    rim_mm = true_cases.RIM_PER_RADIUS * 2.0
    growth = true_cases.RIM_GROWTH
    np.testing.assert_allclose(sizes, rim_mm + growth * np.array([0.0, 2.0, np.hypot(2.0, 5.0)]))
    assert np.isinf(true_cases.PRESSES["fingers"].rims(points)).all()


def test_a_killed_worker_leaves_the_results_before(
    tiny: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def broken(work: Any, cases: Any, workers: int) -> Any:
        yield work(cases[0])
        raise BrokenProcessPool

    monkeypatch.setattr(tiny, "map_in_processes", broken)
    monkeypatch.setattr(tiny, "run", lambda case, **options: {"error": "none", "seconds": 0.0})
    tiny.main(["--set", "all", "--out", str(tmp_path)])
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert list(result["cases"]) == [tiny.CASES[0].name]
    assert len(list(tmp_path.glob("true_objects_all.*"))) == 2


def test_an_interrupted_run_resumes(
    tiny: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran: list[str] = []

    def run(case: Any, **options: Any) -> dict[str, Any]:
        if len(ran) == 2 and not interrupted:
            interrupted.append(case.name)
            raise KeyboardInterrupt
        ran.append(case.name)
        return {"error": f"refined {options['refined']}", "seconds": 0.0}

    interrupted: list[str] = []
    monkeypatch.setattr(tiny, "run", run)
    arguments = ["--set", "all", "--resume", str(tmp_path)]
    names = [case.name for case in tiny.CASES]
    tiny.main(arguments)
    assert ran == names[:2]
    tiny.main(arguments)
    assert ran == names  # the first two only once
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert list(result["cases"]) == names
    tiny.main([*arguments, "--refined", "0.5"])  # another setup has scores of its own
    assert ran == [*names, *names]
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert result["cases"][names[0]]["error"] == "refined 0.5"


def test_recordings_are_cached(
    tiny: ModuleType, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import true_cases

    case = tiny.CASES[0]
    first = true_cases.make_recording(case, cache)

    def refuse(self: Any) -> None:
        raise AssertionError("solved again")

    monkeypatch.setattr(true_cases.Solution, "solve", refuse)
    second = true_cases.make_recording(case, cache)
    np.testing.assert_array_equal(first.presses[-1].displacement, second.presses[-1].displacement)
    monkeypatch.setattr(true_cases, "FORMAT", true_cases.FORMAT + 1)
    with pytest.raises(AssertionError, match="solved again"):
        true_cases.make_recording(case, cache)


@pytest.mark.slow
def test_the_check_refines_the_truth_mesh(
    tiny: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny.main(["--check", "--cache", str(tmp_path), "--only", "tiny-patch-40db"])
    report = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    change = report["cases"]["tiny-patch-40db"]
    assert change["refined_elements"] > 2 * change["elements"]
    assert 0.0 < change["change"] < 0.1
    assert change["over_noise"] == pytest.approx(100 * change["change"])


def test_half_of_the_cases_are_held_out(benchmark: ModuleType) -> None:
    cases = benchmark.choose_cases("all", None)
    held_out = benchmark.choose_cases("held_out", None)
    names = {case.name for case in cases}
    assert len(names) == len(cases) >= 24
    assert len(held_out) * 2 == len(cases)
    assert len({case.object for case in cases}) >= 10
    assert len(benchmark.choose_cases("empty", None)) == 40
    assert all(not case.body.lumps for case in benchmark.choose_cases("empty", None))


def test_seeds_repeat_each_case_with_other_noise(benchmark: ModuleType) -> None:
    every = benchmark.choose_cases("all", None) + benchmark.choose_cases("random", None)
    repeated = benchmark.with_seeds(every, 3)
    assert repeated[::3] == every
    assert len({case.name for case in repeated}) == 3 * len(every)
    assert repeated[1].solution == every[0].solution
    assert repeated[1].seed != every[0].seed
