"""The surrogate learns, keeps what it worked out, and never makes a start worse."""

import logging
from pathlib import Path

import lightning
import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError, FileError
from tactorch.generation import MeshSizes, PressDraw, Recipe, generate
from tactorch.inverse import (
    Bounds,
    InverseProblem,
    NuisancePrior,
    Settings,
    ShiftedPrior,
    Tikhonov,
    homogeneous,
    invert_map,
)
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.learning.data import AugmentedSamples
from tactorch.learning.recognizer import Recognizer
from tactorch.learning.surrogate import Prediction, SurrogateStart
from tactorch.learning.surrogate import data as feature_cache
from tactorch.learning.surrogate.data import SurrogateData, SurrogateDataOptions, load_features
from tactorch.learning.surrogate.features import SHARED_CHANNELS
from tactorch.learning.surrogate.network import (
    PressUNet,
    Surrogate,
    export_weights,
    load_surrogate,
)
from tactorch.learning.surrogate.predict import fits_better_than_uniform
from tactorch.learning.training import BEST, TrainerOptions, fit
from tactorch.recording import Recording
from tactorch.simulation import perturb_recording


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recipe = Recipe(
        name="balls",
        count=12,
        family={
            "name": "inclusions",
            "count": (1, 1),
            "shapes": ["ball"],
            "contrast": (4.0, 8.0),
            "size": (0.3, 0.35),
        },
        presses=PressDraw(faces=(("z+",), ("z+", "x+", "y+")), load=(0.04, 0.05), steps=(1, 2)),
        mesh=MeshSizes(0.27, None),
        samples=1,
        shard=8,
    )
    return generate(recipe, tmp_path_factory.mktemp("balls") / "balls", workers=1).folder


@pytest.fixture(scope="module")
def data(dataset: Path) -> SurrogateData:
    load_features(dataset, 4, workers=1)  # starting processes would take longer
    options = SurrogateDataOptions(folder=dataset, cells=4, batch=4, shares=(0.5, 0.25, 0.25))
    return SurrogateData(options)


@pytest.fixture(scope="module")
def run(data: SurrogateData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short training."""
    folder = tmp_path_factory.mktemp("run")
    lightning.seed_everything(0, verbose=False)
    sizes = {"cells": 4, "width": 8, "encoded": 4}
    model = Surrogate(data.press_scale, data.shared_scale, learning_rate=1e-2, **sizes)
    scores = fit(model, data, folder, TrainerOptions(max_epochs=30))
    assert scores["test/loss"] < fresh_loss(data)
    return folder


def fresh_loss(data: SurrogateData) -> float:
    lightning.seed_everything(0, verbose=False)
    scales = data.press_scale, data.shared_scale
    model = Surrogate(*scales, cells=4, width=8, encoded=4).eval()
    with torch.no_grad():
        each, _ = model._log_likelihood(next(iter(data.test_dataloader())))
    return float(each.mean())


def test_number_and_order_of_presses_do_not_matter() -> None:
    torch.manual_seed(0)
    network = PressUNet(5, 3, 2, 8, 4).eval()
    presses, shared = torch.randn(2, 4, 5, 4, 4, 4), torch.randn(2, 3, 4, 4, 4)
    mask = torch.tensor([[True, True, False, False], [True, True, True, True]])
    expected = network(presses, mask, shared)
    assert expected.shape == (2, 2, 8, 8, 8)
    order = torch.tensor([2, 0, 3, 1])
    torch.testing.assert_close(network(presses[:, order], mask[:, order], shared), expected)
    alone = network(presses[:1, :2], mask[:1, :2], shared[:1])
    torch.testing.assert_close(alone, expected[:1])
    assert (network(presses[:1, :1], mask[:1, :1], shared[:1]) - alone).abs().max() > 1e-4


def test_each_object_has_its_own_presses(data: SurrogateData) -> None:
    features = data.features
    assert len(features) == 12
    assert {len(sample.presses) for sample in features} == {1, 3}
    presses, mask, shared, target, inside = next(iter(data.test_dataloader()))
    first = features[data.parts["test"][0]]
    count = len(first.presses)
    np.testing.assert_array_equal(mask[0].sum(), count)
    np.testing.assert_array_equal(presses[0, :count], first.presses)
    np.testing.assert_array_equal(target[0], first.target)
    assert inside.all()
    assert shared.shape[1:] == (len(SHARED_CHANNELS), 4, 4, 4)


def test_computed_features_are_cached(dataset: Path, data: SurrogateData, monkeypatch) -> None:
    def never(*args: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(feature_cache, "_compute_part", never)
    assert_same(load_features(dataset, 4), data.features)
    with pytest.raises(AssertionError):
        load_features(dataset, 4, frames=2)


def assert_same(features: list, others: list) -> None:
    for sample, other in zip(features, others, strict=True):
        for name, value in vars(sample).items():
            np.testing.assert_array_equal(value, getattr(other, name))


def test_damaged_files_are_computed_again(dataset: Path, data: SurrogateData) -> None:
    path = sorted((dataset / feature_cache.FOLDER).glob("*.npz"))[1]
    path.write_bytes(path.read_bytes()[:1000])
    assert_same(load_features(dataset, 4, workers=1), data.features)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(40):
        torn = bytearray(whole)
        for place in rng.integers(len(torn), size=3):
            torn[place] ^= 0xFF
        path.write_bytes(torn)
        part = feature_cache._read(path)
        assert part is None or len(part) == 4
    path.write_bytes(whole)


def test_a_turned_object_keeps_its_truth(data: SurrogateData) -> None:
    """Presses, truth and outline turn together: the image stays as like the truth as it was."""
    rows = AugmentedSamples(data, range(6), augment=True)
    for place in range(6):
        features = data.features[place]
        for epoch in range(3):
            presses, shared, target, _ = rows[epoch, place]
            fine = torch.nn.functional.interpolate(shared[None], scale_factor=2)[0, 1]
            turned = torch.corrcoef(torch.stack([fine.ravel(), target.ravel()]))[0, 1]
            own = torch.from_numpy(features.shared).float()
            fine = torch.nn.functional.interpolate(own[None], scale_factor=2)[0, 1]
            truth = torch.from_numpy(features.target).float()
            plain = torch.corrcoef(torch.stack([fine.ravel(), truth.ravel()]))[0, 1]
            torch.testing.assert_close(turned, plain, atol=1e-4, rtol=0.0)
            # Tractions push into the object, on whatever side.
            push = presses[:, 6:9] * presses[:, 9:10]
            middle = (torch.arange(4) - 1.5)[:, None, None]
            into = push[:, 0] * middle + push[:, 1] * middle.reshape(1, 4, 1)
            into = into + push[:, 2] * middle.reshape(1, 1, 4)
            assert into.sum() < 0


def test_weights_travel(run: Path, tmp_path: Path, recording: Recording) -> None:
    """Integers of few bits change little, and the file is small."""
    export_weights(run / BEST, tmp_path / "small.pt")
    assert (tmp_path / "small.pt").stat().st_size < 0.2 * (run / BEST).stat().st_size
    whole, small = SurrogateStart(run / BEST), SurrogateStart(tmp_path / "small.pt")
    assert whole.network.cells == small.network.cells == 4
    a, b = whole.predict(recording), small.predict(recording)
    np.testing.assert_allclose(np.log(b.youngs), np.log(a.youngs), atol=0.02)
    assert (a.deviation > 0).all()
    assert a.youngs.shape == recording.truth.shape


def test_only_weights_of_a_surrogate_are_exported(run: Path, tmp_path: Path) -> None:
    content = torch.load(run / BEST, weights_only=True)
    del content["hyper_parameters"]
    torch.save(content, tmp_path / "other.ckpt")
    with pytest.raises(FileError, match=r"other.ckpt' are not a surrogate's \('hyper_parameters'"):
        export_weights(tmp_path / "other.ckpt", tmp_path / "small.pt")
    assert not (tmp_path / "small.pt").exists()


def test_an_inversion_starts_from_it(run: Path, recording: Recording) -> None:
    start = SurrogateStart(run / BEST)
    settings = Settings(max_seconds=None)
    seen: list[np.ndarray] = []
    found = invert_map(
        recording, settings, start_mpa=start, on_iteration=lambda record, map_: seen.append(map_)
    )
    assert found.config["start_mpa"] == "surrogate"
    expected = start(InverseProblem(recording), Bounds())
    np.testing.assert_allclose(seen[0], expected, rtol=1e-10)
    assert np.ptp(seen[0]) > 0


class GivenMap(SurrogateStart):
    """A surrogate that predicts a given map."""

    def __init__(self, youngs: np.ndarray, **settings: object) -> None:
        super().__init__(**settings)
        vars(self)["youngs"] = youngs

    def predict(self, recording: Recording, **others: object) -> Prediction:
        return Prediction(self.youngs, np.ones_like(self.youngs))


@pytest.mark.parametrize(
    "kind", ["upside down", pytest.param("collapsing", marks=pytest.mark.slow)]
)
def test_a_poor_map_is_refused(
    recording: Recording, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    """As a start and as a mean of the prior; and a good one is taken."""
    problem, bounds = InverseProblem(recording), Bounds()
    uniform = homogeneous(problem, bounds)
    truth = recording.truth
    assert truth is not None
    poor = GivenMap(uniform**2 / truth if kind == "upside down" else 0.001 * truth)
    with caplog.at_level(logging.WARNING):
        taken = poor(problem, bounds)
        settings = poor.with_prior_mean(Settings(), recording)
    np.testing.assert_array_equal(taken, uniform)
    assert settings == Settings()
    reason = "its misfit" if kind == "upside down" else "the presses collapse it"
    assert caplog.text.count(f"surrogate's map is refused: {reason}") == 2
    good = GivenMap(truth)
    np.testing.assert_array_equal(good(problem, bounds), truth)
    about = good.with_prior_mean(Settings(), recording)
    assert about == Settings(regularization=ShiftedPrior(mean_mpa=truth, share=0.5))


def test_only_a_map_that_explains_the_presses_is_trusted(
    recording: Recording, caplog: pytest.LogCaptureFixture
) -> None:
    truth = recording.truth
    assert truth is not None
    uniform = homogeneous(InverseProblem(recording), Bounds())
    half = GivenMap(np.sqrt(uniform * truth))  # better than uniform, but not as good as the noise
    with caplog.at_level(logging.INFO):
        assert half.with_prior_mean(Settings(), recording) == Settings()
    assert "The surrogate's map is not used as the mean of the prior: its chi2" in caplog.text
    forced = GivenMap(half.youngs, prior_mean=True).with_prior_mean(Settings(), recording)
    assert isinstance(forced.regularization, ShiftedPrior)


def test_free_nuisance_parameters_do_not_hide_a_poor_map(recording: Recording) -> None:
    """Both maps are evaluated at the nuisance values from which inversions start."""
    free, bounds = NuisancePrior(rest_scale=0.1), Bounds()
    problem = InverseProblem(perturb_recording(recording, size=1.05), nuisance=free)
    plain = uniform_fit(problem, bounds).youngs_mpa
    known = problem.evaluate(np.full(problem.n_elements, plain)).chi2
    worse = np.full(problem.n_elements, 1.05 * plain)
    assert known < problem.evaluate(worse).chi2
    assert not fits_better_than_uniform(worse, problem, bounds)


@pytest.mark.parametrize(
    "settings",
    [
        Settings(regularization="none"),
        Settings(regularization="binary_well"),
        Settings(regularization=Tikhonov(level_mpa=0.2)),
    ],
)
def test_priors_without_use_for_a_mean(recording: Recording, settings: Settings) -> None:
    with pytest.raises(ConfigError, match="cannot be the mean of"):
        GivenMap(np.ones(recording.mesh.n_tets)).with_prior_mean(settings, recording)


def test_wrong_weights_are_named(run: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"not found: .*none\.ckpt"):
        load_surrogate(tmp_path / "none.ckpt")
    (tmp_path / "torn.ckpt").write_bytes((run / BEST).read_bytes()[:500])
    with pytest.raises(FileError, match="damaged"):
        load_surrogate(tmp_path / "torn.ckpt")
    other = Recognizer(["a", "b"], hidden=4, layers=2)
    content = {"state_dict": other.state_dict(), "hyper_parameters": dict(other.hparams)}
    torch.save(content, tmp_path / "other.ckpt")
    with pytest.raises(FileError, match="are not a surrogate's"):
        load_surrogate(tmp_path / "other.ckpt")
    content = torch.load(run / BEST, weights_only=True)
    content["hyper_parameters"]["version"] = 0
    torch.save(content, tmp_path / "old.ckpt")
    with pytest.raises(FileError, match="version 0"):
        load_surrogate(tmp_path / "old.ckpt")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"batch": 0}, "batch"),
        ({"cells": 5}, "cells=5: .* even"),
        ({"split": -1}, "split"),
    ],
)
def test_settings_that_cannot_be(dataset: Path, settings: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SurrogateDataOptions(folder=dataset, **{"cells": 4, **settings})
