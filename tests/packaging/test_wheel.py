"""The built wheel: one top-level package, configs inside it, usable in an empty folder."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
INPUTS = ("tactorch", "conf", "pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")
# Folders beside the package that must stay out of the wheel, with files that would give them away.
STRAYS = ("datasets/recipe.py", "train/recipe.py", "tests/test_x.py", "benchmarks/b.py")
PROBE = "conf/probe_group/deeper/probe.yaml"


def run(*command: str | Path, folder: Path, **environment: str) -> str:
    """Run a command in `folder` and return what it printed; fail with its error output."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=os.environ | {"PIP_NO_INDEX": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"} | environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy what the wheel is made of, so that no earlier build in the checkout can help."""
    folder = tmp_path_factory.mktemp("source")
    for name in INPUTS:
        if (ROOT / name).is_dir():
            ignore = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / name, ignore=ignore)
        else:
            shutil.copy2(ROOT / name, folder / name)
    for stray in (*STRAYS, PROBE):
        (folder / stray).parent.mkdir(parents=True, exist_ok=True)
        (folder / stray).write_text("# not code\n")
    return folder


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = ("wheel", source, "--no-deps", "--no-build-isolation", "-q", "-w", folder)
    run(sys.executable, "-m", "pip", *build, folder=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel alone in a folder of its own."""
    folder = tmp_path_factory.mktemp("site")
    install = ("install", "--no-deps", "-q", "--target", folder, wheel)
    run(sys.executable, "-m", "pip", *install, folder=folder)
    return folder


def test_top_level_is_only_tactorch(names: set[str]) -> None:
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == {"tactorch"}


def test_every_module_is_in_the_wheel(names: set[str]) -> None:
    # A folder that lacks its __init__.py would be left out without a word.
    modules = {p.relative_to(ROOT).as_posix() for p in (ROOT / "tactorch").rglob("*.py")}
    assert modules <= names


def test_type_marker_is_in_the_wheel(names: set[str]) -> None:
    assert "tactorch/py.typed" in names


def test_trained_weights_are_in_the_wheel(names: set[str]) -> None:
    for kind in ("pt", "json"):
        assert f"tactorch/learning/surrogate/surrogate.{kind}" in names


def test_numbers_of_the_paper_are_in_the_wheel(names: set[str]) -> None:
    assert "tactorch/reproduce/paper.yaml" in names
    assert "tactorch/generation/card.md" in names


def test_scripts_for_shells_are_in_the_wheel(names: set[str]) -> None:
    for shell in ("bash", "zsh", "fish"):
        assert f"tactorch/cli/shells/tactorch.{shell}" in names


def test_the_page_of_the_report_is_in_the_wheel(names: set[str]) -> None:
    page = (ROOT / "tactorch" / "report" / "page").iterdir()
    found = {p.relative_to(ROOT).as_posix() for p in page}
    assert len(found) == 13
    assert found <= names


def test_configs_are_inside_the_package(names: set[str], source: Path) -> None:
    found = (source / "conf").rglob("*.yaml")
    configs = {f"tactorch/{p.relative_to(source).as_posix()}" for p in found}
    assert f"tactorch/{PROBE}" in configs
    inside = {name for name in names if name.startswith("tactorch/conf/")}
    assert {name for name in inside if name.endswith(".yaml")} == configs


def test_descriptions_of_sensors_are_in_the_wheel(names: set[str], source: Path) -> None:
    found = list((source / "tactorch/sensor/sensors").glob("*.yaml"))
    assert found
    assert {p.relative_to(source).as_posix() for p in found} <= names


def test_metadata_names_command_and_licence(wheel: Path, names: set[str]) -> None:
    (info,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
    with zipfile.ZipFile(wheel) as archive:
        entry_points = archive.read(f"{info}/entry_points.txt").decode()
        metadata = archive.read(f"{info}/METADATA").decode()
    assert "tactorch = tactorch.cli:main" in entry_points
    assert "License-Expression: Apache-2.0" in metadata
    assert f"{info}/licenses/LICENSE" in names


def test_installed_wheel_finds_its_configs_in_an_empty_folder(site: Path, tmp_path: Path) -> None:
    code = (
        "import tactorch, tactorch.conf, importlib.resources as r;"
        "print(tactorch.__file__);"
        "print((r.files('tactorch.conf') / 'probe_group/deeper/probe.yaml').read_text().strip())"
    )
    package, probe = run(
        sys.executable, "-c", code, folder=tmp_path, PYTHONPATH=str(site)
    ).splitlines()
    assert Path(package).is_relative_to(site)
    assert probe == "# not code"


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the programs of a new environment that holds the wheel, and borrows all it needs.

    A path in a .pth file is searched, but .pth files there are not read: an editable install of
    the checkout stays out.
    """
    folder = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--without-pip", folder, folder=folder)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    python = programs / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "-q", wheel,
        folder=folder)  # fmt: skip
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    own = Path(run(python, "-c", ask, folder=folder).strip())
    (own / "borrowed.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return programs


@pytest.mark.slow
def test_command_of_the_wheel_simulates_and_inverts_in_an_empty_folder(
    environment: Path, tmp_path: Path
) -> None:
    tiny = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null")
    command = environment / "tactorch"
    run(command, "simulate", *tiny, "press=top", "press.steps=1", "out=case.h5", folder=tmp_path)
    brief = ("optimizer.max_iterations=1", "run_dir=run", "plots=false", "method=map")
    out = run(command, "invert", "recording=case.h5", *brief, folder=tmp_path)
    assert "gauss_newton: 1 iterations" in out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["iterations"] == 1
    home = run(environment / "python", "-c", "import tactorch; print(tactorch.__file__)",
               folder=tmp_path)  # fmt: skip
    assert Path(home.strip()).is_relative_to(environment.parent)


@pytest.mark.parametrize("module", ["datasets", "train"])
def test_environment_of_the_wheel_has_nothing_else_of_ours(
    environment: Path, tmp_path: Path, module: str
) -> None:
    code = (
        f"try: import {module} as found; print(*found.__path__)\n"
        "except ModuleNotFoundError: print('nothing')"
    )
    found = run(environment / "python", "-c", code, folder=tmp_path).strip()
    # Another project's package of that name may be installed.
    assert Path(found) != ROOT / module
    assert not found.startswith(str(environment.parent))


@pytest.mark.parametrize("module", ["datasets", "train", "tests", "conf", "benchmarks"])
def test_nothing_else_of_ours_becomes_importable(site: Path, tmp_path: Path, module: str) -> None:
    code = (
        "import importlib.util as u;"
        f"s = u.find_spec('{module}'); print(list(s.submodule_search_locations) if s else [])"
    )
    found = run(sys.executable, "-c", code, folder=tmp_path, PYTHONPATH=str(site))
    assert str(site) not in found
    assert str(ROOT) not in found  # nor through an editable install of the checkout
