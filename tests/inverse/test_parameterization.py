import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tactorch.errors import ConfigError
from tactorch.inverse import PARAMETERIZATIONS, Bounds, Log, Parameterization, Scaled

NAMES = sorted(PARAMETERIZATIONS.names())
MODULI = arrays(np.float64, st.integers(1, 20), elements=st.floats(0.001, 100.0))


@pytest.fixture(params=NAMES)
def parameterization(request: pytest.FixtureRequest) -> Parameterization:
    return PARAMETERIZATIONS[request.param]()


@pytest.mark.parametrize("name", NAMES)
@given(youngs=MODULI)
def test_round_trip(name: str, youngs: np.ndarray) -> None:
    p = PARAMETERIZATIONS[name]()
    np.testing.assert_allclose(p.youngs(p.parameters(youngs)), youngs, rtol=1e-10)


@pytest.mark.parametrize("name", NAMES)
@given(youngs=MODULI, share=st.floats(0.01, 0.99))
def test_slope_is_the_finite_difference(name: str, youngs: np.ndarray, share: float) -> None:
    p = PARAMETERIZATIONS[name]()
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
    assert PARAMETERIZATIONS["identity"](bounds).parameters(youngs)[0] == 0.5
    assert PARAMETERIZATIONS["scaled"](bounds).parameters(youngs)[0] == 0.25
    assert PARAMETERIZATIONS["log"](bounds).parameters(youngs)[0] == np.log(0.5)
    assert PARAMETERIZATIONS["scaled"](bounds).limits == (0.0, 1.0)


NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(60)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def _variance(p: Parameterization, mean: float, variance: float) -> float:
    """Variance of the modulus of a normal parameter, by quadrature."""
    youngs = p.youngs(mean + np.sqrt(variance) * NODES)
    return float((youngs - youngs @ WEIGHTS) ** 2 @ WEIGHTS)


@pytest.mark.parametrize(
    ("name", "mean", "before", "after"),
    [("identity", 0.3, 0.04, 0.01), ("scaled", 0.5, 0.002, 0.0), ("log", -1.0, 0.8, 0.3)],
)
def test_variance_falls_as_its_mean_over_all_data(
    name: str, mean: float, before: float, after: float
) -> None:
    p = PARAMETERIZATIONS[name]()
    means = mean + np.sqrt(before - after) * NODES  # of the parameter, once more is known
    later = np.array([_variance(p, float(m), after) for m in means]) @ WEIGHTS
    fall = _variance(p, mean, before) - later
    found = p.expected_variance_reduction(np.array([mean]), np.array([before]), np.array([after]))
    np.testing.assert_allclose(found, fall, rtol=1e-9)


def test_logs_are_never_less_certain_than_the_bounds() -> None:
    log = Log()
    wide = log.expected_variance_reduction(np.zeros(2), np.array([1e3, 1e6]), np.array([0.0, 0.0]))
    assert np.isfinite(wide).all()
    assert wide[0] == pytest.approx(wide[1])


def test_scaled_never_falls_below_its_bound() -> None:
    assert Scaled().youngs(np.array([-1e-9]))[0] == 0.001


@pytest.mark.parametrize(
    "limits", [(0.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (2.0, 1.0), (0.1, np.inf), (np.nan, 1.0)]
)
def test_useless_bounds_are_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="bounds"):
        Bounds(*limits)


def test_unknown_name_is_refused_with_the_choices() -> None:
    with pytest.raises(ConfigError, match=r"parameterization=logit is unknown.*log"):
        PARAMETERIZATIONS.build("logit")


@pytest.mark.parametrize("name", PARAMETERIZATIONS.names())
def test_the_second_derivative_is_that_of_the_first(name: str) -> None:
    parameterization = PARAMETERIZATIONS.build(name)
    x = parameterization.parameters(np.array([0.05, 0.2, 3.0]))
    h = 1e-6
    rise = parameterization.slope(x + h) - parameterization.slope(x - h)
    np.testing.assert_allclose(parameterization.second_derivative(x), rise / (2 * h), rtol=1e-6)


def test_a_parameterization_must_have_a_second_derivative() -> None:
    """Zero would be silently wrong for a curved one."""

    class Squared(Parameterization):
        def youngs(self, x: np.ndarray) -> np.ndarray:
            return x**2

        def slope(self, x: np.ndarray) -> np.ndarray:
            return 2.0 * x

        def parameters(self, youngs: np.ndarray) -> np.ndarray:
            return np.sqrt(youngs)

    with pytest.raises(TypeError, match="second_derivative"):
        Squared()
