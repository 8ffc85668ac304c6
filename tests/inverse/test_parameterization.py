import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tactorch.errors import ConfigError
from tactorch.inverse import PARAMETERIZATIONS, Bounds, Parameterization, make_parameterization

NAMES = sorted(PARAMETERIZATIONS)
MODULI = arrays(np.float64, st.integers(1, 20), elements=st.floats(0.001, 100.0))


@pytest.fixture(params=NAMES)
def parameterization(request: pytest.FixtureRequest) -> Parameterization:
    return make_parameterization(request.param)


@pytest.mark.parametrize("name", NAMES)
@given(youngs=MODULI)
def test_round_trip(name: str, youngs: np.ndarray) -> None:
    p = make_parameterization(name)
    np.testing.assert_allclose(p.youngs(p.parameters(youngs)), youngs, rtol=1e-10)


@pytest.mark.parametrize("name", NAMES)
@given(youngs=MODULI, share=st.floats(0.01, 0.99))
def test_slope_is_the_finite_difference(name: str, youngs: np.ndarray, share: float) -> None:
    p = make_parameterization(name)
    low, high = p.limits
    x = p.parameters(youngs) * share + (1 - share) * 0.5 * (low + high)
    h = 1e-6 * (high - low)
    expected = (p.youngs(x + h) - p.youngs(x - h)) / (2 * h)
    np.testing.assert_allclose(p.slope(x), expected, rtol=1e-5)


def test_limits_are_the_bounds(parameterization: Parameterization) -> None:
    low, high = parameterization.limits
    assert low < high
    np.testing.assert_allclose(
        parameterization.youngs(np.array([low, high])), [0.001, 100.0], rtol=1e-12
    )


def test_order_is_kept(parameterization: Parameterization) -> None:
    x = parameterization.parameters(np.array([0.001, 0.2, 0.21, 100.0]))
    assert (np.diff(x) > 0).all()


def test_what_x_means() -> None:
    youngs = np.array([0.5])
    bounds = Bounds(0.25, 1.25)
    assert make_parameterization("identity", bounds).parameters(youngs)[0] == 0.5
    assert make_parameterization("scaled", bounds).parameters(youngs)[0] == 0.25
    assert make_parameterization("log", bounds).parameters(youngs)[0] == np.log(0.5)
    assert make_parameterization("scaled", bounds).limits == (0.0, 1.0)


def test_scaled_never_falls_below_its_bound() -> None:
    assert make_parameterization("scaled").youngs(np.array([-1e-9]))[0] == 0.001


@pytest.mark.parametrize(
    "limits", [(0.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (2.0, 1.0), (0.1, np.inf), (np.nan, 1.0)]
)
def test_useless_bounds_are_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="bounds"):
        Bounds(*limits)


def test_unknown_name_is_refused_with_the_choices() -> None:
    with pytest.raises(ConfigError, match=r"'logit' is unknown.*log"):
        make_parameterization("logit")
