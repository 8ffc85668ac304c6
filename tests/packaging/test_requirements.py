"""pyproject.toml says what may be used, constraints.txt what is tested: they must agree."""

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def requirements() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    named = [*extras["test"], *extras["dev"], *extras["docs"]]
    return [Requirement(r) for r in [*project["dependencies"], *named]]


@pytest.fixture(scope="module")
def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {name: version for name, version in pairs}


def test_every_requirement_is_pinned_within_its_range(
    requirements: list[Requirement], pins: dict[str, str]
) -> None:
    for requirement in requirements:
        version = pins[canonicalize_name(requirement.name)]
        assert version in requirement.specifier, requirement


def test_pins_are_plain_versions_from_any_index(pins: dict[str, str]) -> None:
    assert not [name for name, version in pins.items() if "+" in version]
    assert "://" not in (ROOT / "constraints.txt").read_text()


def test_nothing_pulls_cuda_or_torchvision(pins: dict[str, str]) -> None:
    unwanted = ("nvidia", "cuda", "cupy", "torchvision", "triton")
    assert not [name for name in pins if name.startswith(unwanted)]


def test_the_citation_has_the_version_of_the_package() -> None:
    import yaml

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert citation["title"] == project["name"]
    assert citation["cff-version"] == "1.2.0"
    assert citation["authors"]
