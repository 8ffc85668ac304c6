from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

import pytest

from tactorch.config import REGISTRIES, Options, Registry, option
from tactorch.config import registry as module
from tactorch.errors import ConfigError


@dataclass(frozen=True)
class Own(Options):
    section = "shapes"
    size: float = option(1.0, "Size", gt=0)


def test_installed_packages_are_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The name of a component is looked up for each press that is saved."""
    searches = []

    def search() -> tuple[()]:
        searches.append(1)
        return ()

    monkeypatch.setattr(module.metadata, "distributions", search)
    monkeypatch.setattr(module, "entry_points", cache(module.entry_points.__wrapped__))
    monkeypatch.setattr(module, "REGISTRIES", {})
    for section in ("shapes", "bodies"):
        registry = Registry(section, {"own": f"{__name__}:Own"})
        assert [registry.name_of(Own) for _ in range(3)] == ["own"] * 3
    assert len(searches) == 1


@pytest.fixture
def shapes(monkeypatch: pytest.MonkeyPatch) -> Registry:
    entries = [
        EntryPoint("other", f"{__name__}:Own", "tactorch.shapes"),
        EntryPoint("ordered", "collections:OrderedDict", "tactorch.shapes"),
        EntryPoint("broken", "no_such_package_here:Thing", "tactorch.shapes"),
    ]
    monkeypatch.setattr(module, "entry_points", lambda: entries)
    monkeypatch.setattr(module, "REGISTRIES", dict(REGISTRIES))
    return Registry("shapes", {"own": f"{__name__}:Own"})


def test_components_come_from_the_package_and_from_others(shapes: Registry) -> None:
    assert shapes.names() == ("own", "broken", "ordered", "other")
    assert shapes["own"] is Own
    assert shapes["other"] is Own


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("on", "shapes=on is unknown; choose one of own, broken, ordered, other. Did you mean"),
        ("ordered", "collections:OrderedDict is no own; derive the class from"),
        ("broken", "no_such_package_here:Thing cannot be loaded"),
    ],
)
def test_what_cannot_be_used_is_said(shapes: Registry, name: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        shapes[name]
    assert message in str(error.value)


def test_a_component_is_registered_once(shapes: Registry) -> None:
    shapes.register("mine", Own)
    assert shapes.build({"name": "mine", "size": 2}) == Own(2.0)
    assert shapes.name_of(Own) == "own"
    with pytest.raises(ConfigError, match="shapes 'mine' exists"):
        shapes.register("mine", Own)


@pytest.mark.parametrize("given", [Own(3.0), 5, None])
def test_an_object_is_taken_as_it_is(shapes: Registry, given: Any) -> None:
    assert shapes.build(given) is given
