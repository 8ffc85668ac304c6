"""Structure of a checkout in numbers: size, public names, cost of an extension, depth of a call.

    python benchmarks/structure.py [CHECKOUT] [--before CHECKOUT] [--out FOLDER]

Each figure is counted from the sources:

- lines: all lines of tactorch/**/*.py, and those that are neither blank, comment nor docstring;
  lines of the settings in conf/, which is installed as tactorch/conf;
- public names: entries of `__all__`, each name once;
- files per extension: files of tactorch/ and conf/ that name an existing component (its class or
  its setting), that is, the files that a new one of its kind touches;
- frames: functions of tactorch on the deepest stack between `tactorch invert` and an element
  kernel, in a process with Numba's compiler off, for one press on a cube of five tetrahedra;
- record types: public dataclasses and named tuples that functions of the sensor pipeline return
  on the way from a frame to a press, settings excepted;
- repeated defaults: settings whose default stands in conf/ and again in a class or signature.

`--before` prints a second column. The last line is one JSON object.
"""

import argparse
import ast
import json
import os
import re
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

#: An existing component of each kind: its setting, its class and a setting of this component.
EXTENSIONS = {
    "material": ("mooney_rivlin", "MooneyRivlin"),
    "prior": ("matern", "Matern", "length_mm"),
    "optimizer": ("lbfgs", "LBFGS", "stage_iterations"),
    "sensor map": ("lookup", "LookupMap"),
}
#: Parts of the sensor package that a frame passes on its way to a press.
PIPELINE = ("frames", "markers", "depth", "gel", "contact", "recorder", "chain", "pose")
_TRACE = """
import sys, threading
deepest, root = [0], {root!r}
def depth(frame, event, argument):
    file = frame.f_code.co_filename
    if event != "call" or not (file.startswith(root + "/fem/") and "kernels" in file):
        return
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename.startswith(root)
        frame = frame.f_back
    deepest[0] = max(count, deepest[0])
from tactorch.recording import Recording
import tactorch.inverse
sys.setprofile(depth)
threading.setprofile(depth)
from tactorch.cli import main
try:
    main(["invert", "recording=" + sys.argv[1], "run_dir=" + sys.argv[2], "plots=false",
          "method=map", "optimizer.max_iterations=1"])
except SystemExit:
    pass
sys.setprofile(None)
print("frames", deepest[0])
"""
_CASE = """
import sys
from tactorch import PressPlan, make_phantom, simulate
from tactorch.mesh import box_mesh
mesh = box_mesh(10.0, 1, tets_per_cell=5)
ball = make_phantom("cube_sphere")
simulate(ball, PressPlan(["z+"], [0.01]), mesh=mesh, samples=2, snr_db=40).save(sys.argv[1])
"""


def main() -> None:
    """Count, print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).parents[1])
    parser.add_argument("--before", type=Path, help="checkout to compare with")
    parser.add_argument("--out", type=Path, help="folder for structure.json and structure.md")
    options = parser.parse_args()
    results = {"now": figures(options.checkout.resolve())}
    if options.before:
        results = {"before": figures(options.before.resolve()), **results}
    lines = table(results)
    print("\n".join(lines))
    print(json.dumps(results))
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "structure.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (options.out / "structure.json").write_text(json.dumps(results, indent=1) + "\n")


def figures(root: Path) -> dict[str, Any]:
    """Return all figures of a checkout."""
    package = root / "tactorch"
    sources = sorted(package.rglob("*.py"))
    return {
        "files": len(sources),
        "lines": sum(len(path.read_text("utf-8").splitlines()) for path in sources),
        "code lines": sum(code_lines(path) for path in sources),
        "lines of conf": sum(
            len(path.read_text("utf-8").splitlines()) for path in (root / "conf").rglob("*.yaml")
        ),
        "public names": len(public_names(sources)),
        **{f"files for a {kind}": extension_files(root, kind) for kind in EXTENSIONS},
        "frames to the kernel": frames(root),
        "record types": len(record_types(package / "sensor")),
        "repeated defaults": len(repeated_defaults(root)),
    }


def table(results: dict[str, dict[str, Any]]) -> list[str]:
    """Return the figures as a Markdown table."""
    columns = list(results)
    lines = [f"| figure | {' | '.join(columns)} |", "| --- |" + " ---: |" * len(columns)]
    for name in results["now"]:
        values = " | ".join(str(results[column][name]) for column in columns)
        lines.append(f"| {name} | {values} |")
    return lines


def code_lines(path: Path) -> int:
    """Count the lines that hold code: no blanks, comments or docstrings."""
    tree = ast.parse(path.read_text("utf-8"))
    skipped: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    used: set[int] = set()
    blank = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in {*blank, tokenize.ENCODING, tokenize.ENDMARKER}:
                used |= set(range(token.start[0], token.end[0] + 1))
    return len(used - skipped)


def public_names(sources: list[Path]) -> set[str]:
    """Return the names that `__all__` lists, anywhere."""
    names: set[str] = set()
    for path in sources:
        for node in ast.parse(path.read_text("utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            if any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets):
                names |= {n.value for n in ast.walk(node) if isinstance(n, ast.Constant)}
    return names


def extension_files(root: Path, kind: str) -> int:
    """Count the files that name a component of a kind in code or as a setting."""
    words = set(EXTENSIONS[kind])
    sources = [*(root / "tactorch").rglob("*.py")]
    compositions = [*(root / "conf").rglob("*.yaml")]
    return sum(not words.isdisjoint(_code_names(path)) for path in sources) + sum(
        not words.isdisjoint(_setting_names(path)) for path in compositions
    )


def _code_names(path: Path) -> Iterator[str]:
    """Identifiers, and words of strings that hold nothing but names (no prose)."""
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.alias):
            yield node.name
        elif isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.arg | ast.keyword) and node.arg:
            yield node.arg
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and re.fullmatch(r"[\w.:\s]+", str(node.value)):
            yield from re.split(r"[\s:]+", str(node.value))


def _setting_names(path: Path) -> Iterator[str]:
    yield path.stem
    for line in path.read_text("utf-8").splitlines():
        yield from re.findall(r"\w+", line.split("#")[0])


def frames(root: Path) -> int:
    """Return the depth of the stack at the element kernels."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1"}
    local = root / ".venv" / "bin" / "python"
    python = str(local) if local.exists() else sys.executable
    with tempfile.TemporaryDirectory() as folder:
        case = str(Path(folder) / "case.h5")
        subprocess.run([python, "-c", _CASE, case], cwd=root, env=environment, check=True)
        trace = _TRACE.format(root=str(root / "tactorch"))
        arguments = [python, "-c", trace, case, str(Path(folder) / "run")]
        done = subprocess.run(
            arguments, cwd=root, env=environment, check=True, capture_output=True, text=True
        )
    return int(done.stdout.rsplit("frames", 1)[1])


def record_types(sensor: Path) -> set[str]:
    """Return the record types that the pipeline's functions return, and the press."""
    sources = [p for p in sensor.rglob("*.py") if set(p.relative_to(sensor).parts) & _parts()]
    trees = [ast.parse(path.read_text("utf-8")) for path in sources]
    records = {node.name for tree in trees for node in ast.walk(tree) if _is_record(node)}
    returned = {name for tree in trees for name in _returned(tree)}
    return (records & returned) | {"Press"}


def _parts() -> set[str]:
    return {*PIPELINE, *(f"{part}.py" for part in PIPELINE)}


def _is_record(node: ast.AST) -> bool:
    if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
        return False
    bases = {ast.unparse(base) for base in node.bases}
    decorated = any("dataclass" in ast.unparse(d) for d in node.decorator_list)
    is_settings = "Options" in bases or node.name.endswith(("Options", "Limits", "Look"))
    return (decorated or "NamedTuple" in bases) and not is_settings


def _returned(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            yield from re.findall(r"\w+", ast.unparse(node.returns))


def repeated_defaults(root: Path) -> set[str]:
    """Return the settings whose default stands in conf/ and in a class or signature."""
    defaults: dict[str, set[str]] = {}
    for path in (root / "tactorch").rglob("*.py"):
        for name, value in _python_defaults(ast.parse(path.read_text("utf-8"))):
            defaults.setdefault(name, set()).add(value)
    repeated = set()
    for path in (root / "conf").rglob("*.yaml"):
        content = yaml.safe_load(path.read_text("utf-8")) or {}
        for name, value in _leaves(content):
            if _written(value) in defaults.get(name.split(".")[-1], set()):
                group = path.parent.name if path.parent.name != "conf" else ""
                repeated.add(f"{group}/{path.stem}:{name}")
    return repeated


def _python_defaults(tree: ast.AST) -> Iterator[tuple[str, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign) and node.value and isinstance(node.target, ast.Name):
            yield node.target.id, _literal(node.value)
        elif isinstance(node, ast.FunctionDef):
            names = [a.arg for a in node.args.args][
                -len(node.args.defaults) or len(node.args.args) :
            ]
            yield from zip(names, map(_literal, node.args.defaults), strict=False)
            for argument, value in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
                if value is not None:
                    yield argument.arg, _literal(value)


def _literal(node: ast.AST) -> str:
    call = node if isinstance(node, ast.Call) and node.args else None
    node = call.args[0] if call and getattr(call.func, "id", "") == "option" else node
    try:
        return _written(ast.literal_eval(node))
    except ValueError:
        return ""


def _written(value: Any) -> str:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        return repr(float(value)) if number or re.match(r"[\d.]+e", str(value)) else repr(value)
    except ValueError:
        return repr(value)


def _leaves(values: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if prefix == "" and key in ("defaults", "hydra", "name"):
            continue
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif value is not None and value != "???":
            yield f"{prefix}{key}", value


if __name__ == "__main__":
    main()
