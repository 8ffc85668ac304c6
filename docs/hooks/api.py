"""The API reference: every public name, by package, from its docstring.

A package's `__all__` lists what is public. mkdocstrings renders the docstrings; this module lists
the packages and names of each page, and adds a table of the settings of `Options` classes: type,
range, default and help of every field that is declared by `option`.
"""

import ast
import importlib
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import configuration

import tactorch
from tactorch.cli.schema import describe_settings
from tactorch.config import Options

_ROOT = Path(__file__).resolve().parents[2]
#: Pages: title, and the packages (or modules) on it.
PAGES = {
    "recording": ("Recordings", ["tactorch.loading", "tactorch.recording", "tactorch.importers"]),
    "simulation": (
        "Phantoms and simulation",
        ["tactorch.phantoms", "tactorch.simulation", "tactorch.touch"],
    ),
    "inverse": ("Inversion", ["tactorch.inverse"]),
    "uncertainty": (
        "Uncertainty and active sampling",
        ["tactorch.inverse.posterior", "tactorch.metrics.coverage", "tactorch.sampling"],
    ),
    "robot": ("Robots", ["tactorch.robot"]),
    "fem": (
        "Mechanics",
        ["tactorch.fem", "tactorch.fem.contact", "tactorch.fem.materials", "tactorch.linalg"],
    ),
    "mesh": ("Meshes", ["tactorch.mesh", "tactorch.volumes"]),
    "sensor": (
        "Sensors",
        [
            "tactorch.sensor.description",
            "tactorch.sensor.chain",
            "tactorch.sensor.recorder",
            "tactorch.sensor.calibration",
            "tactorch.sensor.scale",
            "tactorch.sensor.frames",
            "tactorch.sensor.markers",
            "tactorch.sensor.marker_match",
            "tactorch.sensor.depth",
            "tactorch.sensor.gel",
            "tactorch.sensor.contact_edge",
            "tactorch.sensor.contact",
            "tactorch.sensor.poses",
            "tactorch.sensor.render",
            "tactorch.sensor.camera",
        ],
    ),
    "learning": (
        "Datasets and networks",
        [
            "tactorch.generation",
            "tactorch.learning",
            "tactorch.learning.surrogate",
            "tactorch.learning.surrogate.network",
            "tactorch.learning.surrogate.data",
            "tactorch.learning.recognizer",
            "tactorch.learning.training",
        ],
    ),
    "more": ("Metrics, pictures and more", ["tactorch.metrics", "tactorch.viz"]),
    "errors": ("Errors", ["tactorch.errors"]),
}
#: The page of packages that none of the others names.
REST = "more"
#: Names that lead their package; the others follow in the order of `__all__`.
FIRST = (
    "Recording", "Press", "Phantom", "make_phantom", "simulate", "PressPlan", "invert", "Settings",
    "Reconstruction", "compute_posterior", "sample", "SoftBody", "Supports", "make_material",
    "TetMesh", "read_mesh", "tetrahedralize", "SensorDescription", "load_sensor", "SensorChain",
    "record", "scores", "find_lump", "find_inclusion", "TactorchError",
)  # fmt: skip


class Origin(NamedTuple):
    """Where a name is defined: the module, and the definition or assignment there."""

    module: str
    node: ast.stmt


def pages() -> dict[str, str]:
    """Return the reference's pages, by path, as Markdown."""
    seen: set[Origin] = set()
    made = {
        f"api/{name}.md": _page(title, packages_of(name), seen)
        for name, (title, _) in PAGES.items()
    }
    return {"api/index.md": _index(), **made}


def packages_of(page: str) -> list[str]:
    """Return the packages of a page; all that export something are on one."""
    named = {package for _, packages in PAGES.values() for package in packages}
    rest = [] if page != REST else [p for p in _exporting() if p not in named]
    return [*PAGES[page][1], *rest]


def _exporting() -> Iterator[str]:
    """Packages with public names, but for the command line and what `tactorch` itself loads."""
    for path in sorted((_ROOT / "tactorch").rglob("__init__.py")):
        package = ".".join(path.parent.relative_to(_ROOT).parts)
        apart = package == "tactorch" or package.startswith("tactorch.cli")
        if not apart and any("__all__" in _targets(node) for node in tree(package).body):
            yield package


def public(module: str) -> list[str]:
    """Return a module's public names, those that lead first."""
    names = [
        node.name
        for node in tree(module).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
    ]
    for node in tree(module).body:
        if isinstance(node, ast.Assign) and "__all__" in _targets(node):
            names = ast.literal_eval(node.value)
    return sorted(names, key=lambda n: FIRST.index(n) if n in FIRST else len(FIRST))


@cache
def origin(module: str, name: str) -> Origin:
    """Return where a name of a module is defined.

    Raises:
        LookupError: It is not there.
    """
    for node in tree(module).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            if any((alias.asname or alias.name) == name for alias in node.names):
                return origin(node.module, name)
        elif name in _targets(node):
            return Origin(module, node)
    raise LookupError(f"{module} has no {name}")


def path_of(module: str, name: str) -> str:
    """Return where mkdocstrings finds a name; one that a submodule has too, at its source."""
    place = _ROOT.joinpath(*module.split("."), name)
    taken = place.with_suffix(".py").is_file() or place.is_dir()
    return f"{origin(module, name).module if taken else module}.{name}"


@cache
def tree(module: str) -> ast.Module:
    """Return the source of a module or package of tactorch."""
    place = _ROOT.joinpath(*module.split("."))
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def docstring(module: str) -> str:
    """Return a module's documentation."""
    return ast.get_docstring(tree(module)) or ""


def _targets(node: ast.stmt) -> list[str]:
    """Names that a statement defines."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _page(title: str, packages: list[str], seen: set[Origin]) -> str:
    parts = [f"# {title}"]
    for package in packages:
        parts += [f"## {package}", docstring(package), *_entries(package, seen)]
    return "\n\n".join(parts) + "\n"


def _entries(module: str, seen: set[Origin]) -> Iterator[str]:
    constants = []
    for name in public(module):
        found = origin(module, name)
        if not isinstance(found.node, ast.ClassDef | ast.FunctionDef):
            constants.append(f"- `{name}`: {_constant(found.node)}")
        elif found not in seen:
            seen.add(found)
            yield f"::: {path_of(module, name)}"
            yield from _settings(found.module, name)
    if constants:
        yield "**Constants**\n\n" + "\n".join(constants)


def _settings(module: str, name: str) -> Iterator[str]:
    """The table of a class's settings, inherited ones included; none for other objects."""
    value = getattr(importlib.import_module(module), name, None)
    if isinstance(value, type) and issubclass(value, Options) and is_dataclass(value):
        entries = list(describe_settings(value))
        if entries:
            yield f"**Settings of `{name}`**\n\n{configuration.table(entries)}"


def _constant(node: ast.stmt) -> str:
    value = getattr(node, "value", None)
    if isinstance(value, ast.Dict):
        return ", ".join(f"`{ast.unparse(key)}`" for key in value.keys if key is not None)
    return f"`{ast.unparse(value)}`" if isinstance(value, ast.expr) else ""


def _index() -> str:
    rows = ["| name | what it is |", "|---|---|"]
    for name in tactorch.__all__:
        home = tactorch._HOME[name]
        node = origin(home, name).node
        assert isinstance(node, ast.ClassDef | ast.FunctionDef)
        about = (ast.get_docstring(node) or "").splitlines()[0]
        rows.append(f"| [`{name}`][{path_of(home, name)}] | {about} |")
    listed = "\n".join(f"- [{title}]({name}.md)" for name, (title, _) in PAGES.items())
    return _INDEX.format(names="\n".join(rows), pages=listed)


_INDEX = """\
# API

Units are mm, N, MPa and tonne/mm³. Arrays are NumPy's but where autograd is meant; their shapes
stand in the annotations: `Float[ndarray, "n 3"]` has n rows of three.

## The names that most users need

All of these are `from tactorch import ...`.

{names}

## By package

{pages}

The command line is in the [configuration reference](../configuration/index.md).
"""
