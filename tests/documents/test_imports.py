"""Imports run downhill: no circles, and the order of the folders of the inversion."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "tactorch"
# Each folder imports those before it only.
INVERSE = ("data", "forward", "errors", "fields", "fit", "posterior", "result", "search")
LOW = ("config", "mesh", "linalg", "fem", "recording", "phantoms", "metrics")


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports() -> dict[str, set[str]]:
    """Return the modules of the package that each one imports, within functions too.

    A package whose `__init__` defers its imports, as `tactorch` does, imports nothing there.
    """
    files = {module_of(path): path for path in PACKAGE.rglob("*.py") if "conf" not in path.parts}
    found: dict[str, set[str]] = {name: set() for name in files}
    for name, path in files.items():
        if name == "tactorch":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for target in names:
                known = target if target in files else target.rpartition(".")[0]
                if known in files and known not in (name, "tactorch"):
                    found[name].add(known)
    return found


def test_there_is_no_circle() -> None:
    order = list(TopologicalSorter(imports()).static_order())
    assert len(order) > 300


def test_folders_of_the_inversion_are_in_the_order_of_the_flow() -> None:
    for name, targets in imports().items():
        parts = name.split(".")
        if parts[:2] != ["tactorch", "inverse"] or len(parts) < 4:
            continue
        for target in targets:
            other = target.split(".")
            if other[:2] == ["tactorch", "inverse"] and len(other) > 2:
                assert other[2] in INVERSE, f"{name} imports {target}"
                assert INVERSE.index(other[2]) <= INVERSE.index(parts[2]), f"{name}: {target}"


def test_low_folders_know_nothing_of_the_inversion() -> None:
    for name, targets in imports().items():
        if name.partition(".")[2].split(".")[0] in LOW:
            above = [t for t in targets if t.split(".")[1] in ("inverse", "viz", "report", "cli")]
            assert not above, f"{name} imports {above}"
