"""The examples run, and print the numbers that they should."""

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tactorch.fem import MATERIALS

ROOT = Path(__file__).resolve().parents[2]
FOLDER, PAGE = ROOT / "examples", ROOT / "docs" / "examples.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")
TESTED = {
    "press": "test_press", "gradient": "test_gradient", "find_ball": "test_find_ball",
    "own_material": "test_own_material", "own_prior": "test_own_prior",
    "next_press": "test_next_press", "robot": "test_robot", "image_to_force": "test_image_to_force",
}  # fmt: skip


def run(name: str, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run an example; what it prints must be what its page says. Return what `main` returns."""
    found = module(name).main()
    check_page(name, capsys.readouterr().out)
    return found


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"examples_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def check_page(name: str, printed: str) -> None:
    """The words are the same, and the numbers but for round-off and another machine's search."""
    pattern = rf"<!-- examples/{name}\.py -->\n\nprints\n\n```text\n(.*?)```"
    told = re.search(pattern, PAGE.read_text(), flags=re.DOTALL)
    assert told is not None, f"{PAGE} does not show what examples/{name}.py prints"
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", told[1])
    for value, shown in zip(numbers(printed), numbers(told[1]), strict=True):
        assert value == pytest.approx(shown, rel=0.15, abs=0.02)


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def test_every_example_is_tested() -> None:
    assert {path.stem for path in FOLDER.glob("*.py")} == set(TESTED)
    assert set(TESTED.values()) <= set(globals())


def test_press(capsys: pytest.CaptureFixture[str]) -> None:
    """Against the exact stretches (see tests/verification/test_uniaxial.py)."""
    found = run("press", capsys)
    exact = {
        0.30: (0.828310984658, 1.056797425871),
        0.45: (0.833017354831, 1.084927637795),
        0.49: (0.834457641796, 1.092545793302),
    }
    assert set(found) == set(exact)
    for poisson, stretches in exact.items():
        assert found[poisson] == pytest.approx(stretches, abs=1e-8)


def test_gradient(capsys: pytest.CaptureFixture[str]) -> None:
    """The exact slope; by pressure it is -E/p of that: E d/dE = -p d/dp, for p/E alone counts."""
    found = run("gradient", capsys)
    assert found["by_youngs"] == pytest.approx(0.138215681, abs=1e-8)
    assert found["by_pressure"] == pytest.approx(-0.138215681 / 0.2, abs=1e-7)
    assert found["by_pressure_quotient"] == pytest.approx(found["by_pressure"], abs=1e-6)
    assert found["curvature"] == pytest.approx(1.2386, abs=1e-3)
    # Of the stretch of the table at nu = 0.45: between the chords to 0.30 and to 0.49.
    assert 0.0313 < found["by_poisson"] < 0.0361


@pytest.mark.slow
def test_find_ball(capsys: pytest.CaptureFixture[str]) -> None:
    found = run("find_ball", capsys)
    assert found["off_mm"] < 0.1
    assert found["radius_mm"] == pytest.approx(2.2, abs=0.2)
    assert 3.5 < found["contrast"] < 6.5
    assert found["pearson"] > 0.95
    assert 0.8 < found["chi2"] < 1.2


@pytest.fixture
def no_new_material() -> Iterator[None]:
    before = dict(MATERIALS._added)
    yield
    MATERIALS._added = before


@pytest.mark.usefixtures("no_new_material")
def test_own_material(capsys: pytest.CaptureFixture[str]) -> None:
    found = run("own_material", capsys)
    assert found["derivatives"] < 1e-7
    assert found["neo_hookean"] == pytest.approx(1.780292, abs=1e-5)
    assert found["fung, b = 1e-6"] == pytest.approx(found["neo_hookean"], abs=1e-5)
    assert found["fung, b = 2"] == pytest.approx(1.358660, abs=1e-5)


def test_own_prior(capsys: pytest.CaptureFixture[str]) -> None:
    found = run("own_prior", capsys)
    assert found["total variation"] == pytest.approx(0.74, abs=0.06)
    assert found["mirrored"] > found["total variation"] + 0.1


@pytest.mark.slow
def test_next_press(capsys: pytest.CaptureFixture[str]) -> None:
    found = run("next_press", capsys)
    assert found["places"] == 3
    assert found["last"] < 0.9 * found["first"]
    assert found["off_mm"] < 3.0


@pytest.mark.slow
def test_robot(capsys: pytest.CaptureFixture[str]) -> None:
    """The run ends by its stop rule, near the ball."""
    found = run("robot", capsys)
    assert 3 <= found["presses"] < 6
    assert found["off_mm"] < 0.6


@pytest.mark.slow
def test_image_to_force(capsys: pytest.CaptureFixture[str]) -> None:
    """From a finer gel's press: within a fifth along z, and sheared the right way."""
    found = run("image_to_force", capsys)
    assert found["estimated"][2] == pytest.approx(found["true"][2], rel=0.2)
    assert found["estimated"][0] == pytest.approx(found["true"][0], rel=0.3)
    assert abs(found["estimated"][1]) < 0.02
