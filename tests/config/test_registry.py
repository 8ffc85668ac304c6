from dataclasses import dataclass
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


@pytest.fixture
def shapes(monkeypatch: pytest.MonkeyPatch) -> Registry:
    entries = [
        EntryPoint("ordered", "collections:OrderedDict", "tactorch.shapes"),
        EntryPoint("broken", "no_such_package_here:Thing", "tactorch.shapes"),
    ]
    monkeypatch.setattr(module, "entry_points", lambda group: entries)
    monkeypatch.setattr(module, "REGISTRIES", dict(REGISTRIES))
    return Registry("shapes", {"path": "pathlib:PurePath"})


def test_components_come_from_the_package_and_from_others(shapes: Registry) -> None:
    assert shapes.names() == ("path", "broken", "ordered")
    assert shapes["path"].__name__ == "PurePath"
    assert shapes["ordered"].__name__ == "OrderedDict"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("pth", "shapes=pth is unknown; choose one of path, broken, ordered. Did you mean 'path'?"),
        ("broken", "no_such_package_here:Thing cannot be loaded"),
    ],
)
def test_what_cannot_be_used_is_said(shapes: Registry, name: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        shapes[name]
    assert message in str(error.value)


def test_a_component_is_registered_once(shapes: Registry) -> None:
    shapes.register("own", Own)
    assert shapes.build({"name": "own", "size": 2}) == Own(2.0)
    assert shapes.name_of(Own) == "own"
    with pytest.raises(ConfigError, match="shapes 'own' exists"):
        shapes.register("own", Own)


@pytest.mark.parametrize("given", [Own(3.0), 5, None])
def test_an_object_is_taken_as_it_is(shapes: Registry, given: Any) -> None:
    assert shapes.build(given) is given
