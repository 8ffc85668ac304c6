from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from tactorch.errors import ConfigError
from tactorch.viz import convergence_figure, save_figure


def history(count: int, seconds: float, rate: float) -> list[dict]:
    return [
        {"iteration": i, "seconds": i * seconds, "misfit": 10.0 * rate**i, "objective": 0.0}
        for i in range(count)
    ]


def test_curves_hold_the_misfit_against_iterations_and_seconds() -> None:
    figure = convergence_figure({"gauss_newton": history(6, 0.5, 0.1), "tnc": history(9, 2.0, 0.8)})
    left, right = figure.axes
    assert (left.get_yscale(), right.get_yscale()) == ("log", "log")
    for axes, step in ((left, 1.0), (right, 2.0)):
        lines = {line.get_label(): line for line in axes.get_lines()}
        assert set(lines) == {"gauss_newton", "tnc"}
        x, y = lines["tnc"].get_data()
        np.testing.assert_allclose(x, step * np.arange(9))
        np.testing.assert_allclose(y, 10.0 * 0.8 ** np.arange(9))
        assert lines["tnc"].get_linestyle() != lines["gauss_newton"].get_linestyle()
        assert lines["tnc"].get_color() != lines["gauss_newton"].get_color()
    assert {text.get_text() for text in right.get_legend().get_texts()} == {"gauss_newton", "tnc"}


def test_noise_level_is_drawn_on_both_panels() -> None:
    figure = convergence_figure({"a": history(4, 1.0, 0.1)}, noise_level=0.03)
    for axes in figure.axes:
        assert [0.03, 0.03] in [list(line.get_ydata()) for line in axes.get_lines()]


def test_few_iterations_stay_readable_beside_many() -> None:
    few, many = history(10, 1.0, 0.5), history(200, 1.0, 0.9)
    left, right = convergence_figure({"gauss_newton": few, "tnc": many}).axes
    assert (left.get_xscale(), right.get_xscale()) == ("symlog", "linear")
    assert convergence_figure({"gauss_newton": few}).axes[0].get_xscale() == "linear"


def test_picture_is_written(tmp_path: Path) -> None:
    path = save_figure(
        convergence_figure({"a": history(5, 1.0, 0.1)}, title="box"), tmp_path / "c.png"
    )
    picture = imread(path)
    assert (np.abs(picture[..., :3] - to_rgb("#0072B2")).max(axis=-1) < 0.02).sum() > 300
    assert [p.name for p in tmp_path.iterdir()] == ["c.png"]


@pytest.mark.parametrize(
    ("histories", "words"),
    [
        ({}, "no history"),
        ({"tnc": []}, "'tnc' is empty"),
        ({"tnc": [{"iteration": 0, "misfit": 1.0}]}, "record 0: no field 'seconds'"),
        (
            {"tnc": [*history(2, 1.0, 0.1), {"iteration": 2, "seconds": 1, "misfit": np.nan}]},
            "record 2: misfit is nan",
        ),
    ],
)
def test_unusable_histories_are_refused(histories: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        convergence_figure(histories)


def test_without_displacements_the_mean_squared_residual_is_drawn() -> None:
    records = [
        {"iteration": i, "seconds": 1.0 * i, "misfit": 0.0, "chi2": 10.0 * 0.5**i} for i in range(4)
    ]
    figure = convergence_figure({"gauss_newton": records})
    left = figure.axes[0]
    np.testing.assert_allclose(left.lines[0].get_ydata(), [10.0, 5.0, 2.5, 1.25])
    assert "mean squared residual" in left.get_ylabel()
