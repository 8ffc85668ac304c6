"""Pages that are made when the site is built: nothing of conf/ or of the packages is left out."""

import html
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from types import ModuleType

import pytest

from tactorch.cli import COMMANDS
from tactorch.cli.schema import load_schema

from .blocks import DOCS, ROOT, pages


@pytest.fixture(scope="module")
def hooks() -> Iterator[dict[str, ModuleType]]:
    sys.path.insert(0, str(DOCS / "hooks"))
    yield {name: importlib.import_module(name) for name in ("configuration", "api", "equations")}
    sys.path.remove(str(DOCS / "hooks"))


@pytest.fixture(scope="module")
def configuration(hooks: dict[str, ModuleType]) -> dict[str, str]:
    pages: dict[str, str] = hooks["configuration"].pages()
    return pages


@pytest.mark.parametrize("command", COMMANDS)
def test_every_setting_of_a_command_is_there(command: str, configuration: dict[str, str]) -> None:
    schema = load_schema(command)
    page = configuration[f"configuration/{command.replace(' ', '-')}.md"]
    assert page.startswith(f"# tactorch {command}\n")
    for entry in schema.settings:
        assert f"| `{entry['name']}` |" in page
    for group in schema.groups:
        assert f"(group-{group}.md)" in page
        text = configuration[f"configuration/group-{group}.md"]
        for option, described in schema.options(group).items():
            assert f"\n## {group}={option}" in text
            assert html.escape(described["help"], False) in text
            for entry in described["settings"]:
                assert f"| `{group}.{entry['name']}` |" in text
                assert html.escape(entry["help"], False).replace("|", "\\|") in text


def test_the_pages_of_the_configuration_are_in_the_navigation(
    hooks: dict[str, ModuleType], configuration: dict[str, str]
) -> None:
    overview, commands, groups = hooks["configuration"].navigation()
    named = [*overview.values(), *commands["Commands"], *groups["Groups"]]
    assert sorted(named) == sorted(configuration)
    longest = max(len(text.splitlines()) for text in configuration.values())
    assert longest < 400


def test_every_package_is_on_one_page_of_the_api(hooks: dict[str, ModuleType]) -> None:
    listed = [package for page in hooks["api"].PAGES for package in hooks["api"].packages_of(page)]
    assert len(listed) == len(set(listed))
    for path in (ROOT / "tactorch").rglob("__init__.py"):
        package = ".".join(path.parent.relative_to(ROOT).parts)
        apart = package == "tactorch" or package.startswith("tactorch.cli")
        assert apart or "\n__all__" not in path.read_text() or package in listed, package


@pytest.mark.slow  # it imports all there is
def test_every_public_name_is_in_the_api(hooks: dict[str, ModuleType]) -> None:
    api = hooks["api"]
    text = "\n".join(api.pages().values())
    shown = re.findall(r"^::: (\S+)$", text, flags=re.MULTILINE)
    assert len(shown) == len(set(shown))
    objects = [
        getattr(importlib.import_module(p.rpartition(".")[0]), p.rpartition(".")[2]) for p in shown
    ]
    for package in (package for page in api.PAGES for package in api.packages_of(page)):
        module = importlib.import_module(package)
        for name in vars(module).get("__all__", ()):
            value = getattr(module, name)
            if inspect.isclass(value) or inspect.isfunction(value):
                listed = f"\n- `{name}`: " in text  # an alias of a type, among the constants
                assert listed or any(value is other for other in objects), name


def test_the_api_shows_the_settings_of_a_class(hooks: dict[str, ModuleType]) -> None:
    """Type, range, default and help from `option(...)`, of inherited fields too."""
    (table,) = hooks["api"]._settings("tactorch.fem.materials.isotropic", "MooneyRivlin")
    (row,) = [line for line in table.splitlines() if line.startswith("| `second_fraction` |")]
    assert row.endswith("| `0.2` | a number, 0 to 1 | c2 / (c1 + c2), from 0 (Neo-Hookean) to 1 |")
    assert "| `poisson` | `0.45` | a number above -1, below 0.5 |" in table
    assert not list(hooks["api"]._settings("tactorch.fem.elements", "Element"))


def test_documents_refer_to_names_that_exist() -> None:
    for page in pages():
        for name in re.findall(r"\]\[(tactorch[\w.]*)\]", page.read_text()):
            module, _, leaf = name.rpartition(".")
            try:
                home = importlib.import_module(module)
            except ModuleNotFoundError:  # a method
                outer, _, middle = module.rpartition(".")
                home = getattr(importlib.import_module(outer), middle)
            assert inspect.isclass(getattr(home, leaf)) or callable(getattr(home, leaf)), name


def test_files_that_documents_name_exist() -> None:
    for page in pages():
        for name in re.findall(
            r"`((?:tactorch|benchmarks|train|examples)/[\w/.]+)", page.read_text()
        ):
            assert (ROOT / name).exists(), f"{page.name}: {name}"


@pytest.mark.parametrize(
    ("latex", "holds"),
    [
        (r"\mathbf R", "<mi>𝐑</mi>"),
        (r"\mathbf u", "<mi>𝐮</mi>"),
        (r"\mathbb R", "<mi>ℝ</mi>"),
        (r"\mathrm{argmin} E", "<mi>argmin</mi>"),
    ],
)
def test_letters_keep_their_look(hooks: dict[str, ModuleType], latex: str, holds: str) -> None:
    """Browsers draw no mathvariant but normal."""
    made = hooks["equations"].mathml(latex)
    assert holds in made
    assert "mathvariant" not in made


def test_equations_keep_their_numbers(hooks: dict[str, ModuleType]) -> None:
    page = '<p>a <span class="arithmatex">\\(x &lt; 1\\)</span></p>\n'
    page += '<div class="arithmatex">\\[ y = 2 \\tag{13} \\]</div>'
    made = hooks["equations"].with_mathml(page)
    assert made.count("<math") == 2
    assert "arithmatex" not in made
    assert '<span class="eq-number">(13)</span>' in made
    assert "tag" not in made.replace("eq-number", "")
