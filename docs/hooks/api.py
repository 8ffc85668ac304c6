"""The API reference: every public name, by package, from its docstring.

What is public a package says in `__all__`. mkdocstrings reads the source; here only pages are laid
out: which packages a page has, and in what order names stand on it.
"""

import importlib
import inspect
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import tactorch

#: Pages: title, and the packages (or modules) on it.
PAGES = {
    "recording": ("Recordings", ["tactorch.recording", "tactorch.importers"]),
    "simulation": ("Phantoms and simulation", ["tactorch.phantoms", "tactorch.simulation"]),
    "inverse": (
        "Inversion",
        [
            "tactorch.inverse",
            "tactorch.inverse.regularization",
            "tactorch.inverse.optimizers",
            "tactorch.inverse.nuisance",
        ],
    ),
    "credibility": ("Credibility and active sampling", ["tactorch.credibility"]),
    "fem": (
        "Mechanics",
        ["tactorch.fem", "tactorch.fem.materials", "tactorch.fem.device", "tactorch.linalg"],
    ),
    "mesh": ("Meshes", ["tactorch.mesh"]),
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
            "tactorch.sensor.depth",
            "tactorch.sensor.gel",
            "tactorch.sensor.contact",
            "tactorch.sensor.render",
        ],
    ),
    "learning": (
        "Datasets and networks",
        [
            "tactorch.generation",
            "tactorch.learning.surrogate",
            "tactorch.learning.surrogate.network",
            "tactorch.learning.surrogate.data",
            "tactorch.learning.recognizer.network",
            "tactorch.learning.recognizer.data",
            "tactorch.learning.training",
        ],
    ),
    "metrics": ("Metrics and pictures", ["tactorch.metrics", "tactorch.viz"]),
    "errors": ("Errors", ["tactorch.errors"]),
}
#: Names that lead their package; the others follow in the order of `__all__`.
FIRST = (
    "Recording", "Press", "Phantom", "make_phantom", "simulate", "PressPlan", "invert", "Settings",
    "Reconstruction", "posterior_of", "sample", "SoftBody", "Supports", "make_material", "TetMesh",
    "read_mesh", "tetrahedralize", "SensorDescription", "load_sensor", "SensorChain", "record",
    "scores", "find_inclusion", "TactorchError",
)  # fmt: skip


def pages() -> dict[str, str]:
    """Return the reference's pages, by path, as Markdown."""
    seen: set[int] = set()
    made = {f"api/{name}.md": _page(*content, seen) for name, content in PAGES.items()}
    return {"api/index.md": _index(), **made}


def public(module: ModuleType) -> list[str]:
    """Return a module's public names, those that lead first."""
    names = getattr(module, "__all__", None) or [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    ]
    return sorted(names, key=lambda n: FIRST.index(n) if n in FIRST else len(FIRST))


def path_of(module: ModuleType, name: str) -> str:
    """Return where mkdocstrings finds a name; one that a submodule has too, at its source."""
    value = getattr(module, name)
    try:
        importlib.import_module(f"{module.__name__}.{name}")
    except ModuleNotFoundError:
        return f"{module.__name__}.{name}"
    return f"{value.__module__}.{name}"


def _page(title: str, packages: list[str], seen: set[int]) -> str:
    parts = [f"# {title}"]
    for package in packages:
        module = importlib.import_module(package)
        parts += [f"## {package}", inspect.getdoc(module) or ""]
        parts += _entries(module, seen)
    return "\n\n".join(parts) + "\n"


def _entries(module: ModuleType, seen: set[int]) -> Iterator[str]:
    constants = []
    for name in public(module):
        value = getattr(module, name)
        if not _documented(value):
            constants.append(f"- `{name}`: {_constant(value)}")
        elif id(value) not in seen:
            seen.add(id(value))
            yield f"::: {path_of(module, name)}"
    if constants:
        yield "**Constants**\n\n" + "\n".join(constants)


def _documented(value: Any) -> bool:
    return inspect.isclass(value) or inspect.isfunction(value)


def _constant(value: Any) -> str:
    if isinstance(value, dict | list | tuple | set | frozenset):
        return ", ".join(f"`{item}`" for item in value)
    return f"`{value}`" if isinstance(value, int | float | str) else "a type of annotations"


def _index() -> str:
    rows = ["| name | what it is |", "|---|---|"]
    for name in tactorch.__all__:
        value = getattr(tactorch, name)
        home = importlib.import_module(tactorch._HOME[name])
        about = (inspect.getdoc(value) or "").splitlines()[0]
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

The command line is in the [configuration reference](../configuration.md).
"""
