"""Every prior and every rule for its weight can be asked for by name."""

from pathlib import Path
from typing import Any

import pytest

from tactorch.inverse import PRIORS, Reconstruction

QUICK = ("plots=false", "method=map", "optimizer.max_iterations=1", "run_dir=run")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in {"matern", "composite"} else [pytest.mark.slow])
        for name in PRIORS.names()
    ],
)
def test_a_prior_by_name(tactorch: Any, recording: Path, name: str) -> None:
    done = tactorch("invert", f"recording={recording}", f"regularization={name}", *QUICK)
    assert done.status == 0, done.err
    settings = Reconstruction.load("run/reconstruction.h5").config["settings"]
    assert settings["regularization"]["name"] == name


@pytest.mark.parametrize(
    "rule",
    [
        pytest.param("discrepancy", marks=pytest.mark.slow),
        "l_curve",
        pytest.param("gcv", marks=pytest.mark.slow),
    ],
)
def test_a_rule_by_name(tactorch: Any, recording: Path, rule: str) -> None:
    words = (f"recording={recording}", f"optimizer.weight_rule={rule}")
    done = tactorch("invert", *words, *QUICK)
    assert done.status == 0, done.err
    found = Reconstruction.load("run/reconstruction.h5")
    assert found.config["optimizer"]["weight_rule"] == rule


def test_settings_of_a_prior_arrive(tactorch: Any, recording: Path) -> None:
    words = ("regularization=binary_well", "regularization.levels_mpa=[0.2,1.0]")
    done = tactorch("invert", f"recording={recording}", *words, *QUICK)
    assert done.status == 0, done.err
    prior = Reconstruction.load("run/reconstruction.h5").config["settings"]["regularization"]
    assert "0.2" in str(prior["levels_mpa"])


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("regularization=matern", "regularization.length_mm=far"), "give a number"),
        (("regularization=binary_well", "regularization.levels_mpa=[1.0]"), "two numbers"),
        (
            ("regularization=composite", "+regularization.parts.ridge=1.0"),
            "regularization=ridge is unknown",
        ),
        (("regularization=tikhonov", "+regularization.bogus=1"), "bogus"),
        (("optimizer.weight_rule=guess",), "weight_rule"),
    ],
)
def test_what_a_prior_cannot_use_is_refused(
    tactorch: Any, recording: Path, words: tuple[str, ...], answer: str
) -> None:
    done = tactorch("invert", f"recording={recording}", *words, *QUICK)
    assert done.status != 0
    assert answer in done.err
