"""The doctor: on this machine, and on machines that lack something or where it is broken."""

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli import doctor
from tactorch.cli.doctor import Check, Finding

CORE = ("torch", "numpy", "scipy", "numba", "h5py", "hydra-core")
TOLD = (
    *("tactorch", "python", "lightning", "opencv-python-headless", "pytetwild", "pypardiso"),
    *("pyamg", "vtk", "dask", "superlu", "multigrid", "torch_cg", "cores"),
    *("threads", "memory", "GPU"),
    *("cache of numba", "settings (conf)", "videos", "mesher"),
)


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Make imports of some modules fail, also where they are loaded already."""
    real = importlib.import_module

    def forget(*names: str, error: Exception | None = None) -> None:
        def load(name: str, package: str | None = None) -> Any:
            if name in names:
                raise error or ModuleNotFoundError(f"No module named '{name}'", name=name)
            return real(name, package)

        monkeypatch.setattr(importlib, "import_module", load)
        for name in names:
            monkeypatch.setitem(sys.modules, name, None)

    return forget


def findings(part: str) -> dict[str, Finding]:
    """Return the findings of the checks of one part, by name."""
    return {check.name: check.run() for check in doctor.CHECKS if check.part == part}


def finding(name: str) -> Finding:
    """Return the finding of one check."""
    return next(check for check in doctor.CHECKS if check.name == name).run()


@pytest.mark.slow
def test_all_is_told_and_the_core_works_here(tactorch: Any) -> None:
    done = tactorch("doctor", "json=true")
    assert done.status == 0, done.out
    found = json.loads(done.out)
    assert found["works"] is True
    message = {one["name"]: one for one in found["findings"]}
    assert {*CORE, *TOLD} <= set(message)
    assert all(message[name]["works"] is True and message[name]["message"] for name in CORE)
    assert message["superlu"]["works"] is True
    assert message["a pressed block"]["works"] is True
    assert not list(Path().iterdir())


def told_of(monkeypatch: pytest.MonkeyPatch, *findings: Finding) -> None:
    """Let the doctor find these alone."""
    monkeypatch.setattr(doctor, "check_all", lambda: findings)


def test_text_is_aligned_and_names_what_to_do(
    tactorch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = "x" * 300
    told_of(
        monkeypatch,
        Finding("packages", "numpy", True, "2.0", "everything", core=True),
        Finding("packages", "pyamg", False, long, "solver=multigrid", 'pip install "pyamg>=5"'),
        Finding("machine", "GPU", None, "none: built without CUDA"),
    )
    done = tactorch("doctor")
    assert done.status == 0
    lines = done.out.splitlines()
    assert [line[10:].split()[:2] for line in lines[1:4]] == [
        ["numpy", "yes"], ["pyamg", "NO"], ["GPU", "-"],
    ]  # fmt: skip
    assert any(line.endswith(long) for line in lines)  # neither wrapped nor cut
    assert any(line.split() == ["pyamg", "solver=multigrid", "pip", "install", '"pyamg>=5"']
               for line in lines)  # fmt: skip
    assert "\x1b" not in done.out
    assert lines[-1] == "The core of tactorch works here; what is listed above does not."


def test_status_is_1_where_the_core_does_not_work(
    tactorch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    told_of(monkeypatch, Finding("packages", "numpy", False, "gone", "everything", core=True))
    assert tactorch("doctor").status == 1
    done = tactorch("doctor", "json=true")
    assert done.status == 1
    assert json.loads(done.out)["works"] is False


def test_unknown_setting_is_refused(tactorch: Any) -> None:
    done = tactorch("doctor", "json=yes")
    assert done.status == 2
    assert "'json=yes'" in done.err
    assert "json=true" in done.err
    assert len(done.err.splitlines()) == 1


def test_missing_package_is_told_with_its_command(without: Callable[..., None]) -> None:
    without("pyamg", "distributed", "cv2")
    found = findings("packages")
    for name, module in (("pyamg", "pyamg"), ("opencv-python-headless", "cv2")):
        assert found[name].works is False
        assert f"No module named '{module}'" in found[name].message
        assert found[name].remedy.startswith(f'pip install "{name}')
    assert found["dask"].remedy == 'pip install "tactorch[dask]"'
    assert found["numpy"].works is True
    assert not any(found[name].core for name in ("pyamg", "dask"))


@pytest.mark.parametrize(
    "error", [ImportError("libx.so: cannot open\nshared object"), RuntimeError(""), OSError("bad")]
)
def test_broken_package_is_no_traceback(without: Callable[..., None], error: Exception) -> None:
    without("numba", error=error)
    found = finding("numba")
    assert found.works is False
    assert found.core
    assert type(error).__name__ in found.message
    assert "\n" not in found.message


def test_version_out_of_range_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "version", lambda name: "0.0.1")
    found = finding("numpy")
    assert found.works is False
    assert "0.0.1 is installed, and tactorch needs >=" in found.message


def test_nothing_installed_by_pip_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise doctor.PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "version", absent)
    monkeypatch.setattr(doctor, "requires", absent)
    doctor._specifiers.cache_clear()
    found = findings("packages")
    doctor._specifiers.cache_clear()
    assert "not installed" in found["tactorch"].message
    assert found["numpy"].works is True
    assert found["numpy"].message == importlib.import_module("numpy").__version__


def test_solver_that_fails_takes_down_itself_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    from tactorch.linalg.iterative import MultigridSolver

    def wrong(self: Any, rhs: Any) -> Any:
        return rhs

    monkeypatch.setattr(MultigridSolver, "solve", wrong)
    found = findings("solvers")
    assert found["multigrid"].works is False
    assert "off by" in found["multigrid"].message
    assert found["multigrid"].remedy.startswith('pip install "pyamg')
    assert found["superlu"].works is True
    assert found["any of them"].works is True
    monkeypatch.setattr(MultigridSolver, "factor", lambda self, values: False)
    assert "indefinite" in finding("multigrid").message


def test_no_solver_at_all_is_a_core_that_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise OSError("libmkl_rt.so.2 is damaged")

    monkeypatch.setattr("tactorch.linalg.analyse", fail)
    monkeypatch.setattr("tactorch.fem.SoftBody", fail)
    found = findings("solvers")
    for name in ("any of them", "a pressed block"):
        assert found[name].works is False
        assert found[name].core


def test_folders_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path / "file"))
    found = finding("cache of meshes")
    assert found.works is False
    assert str(tmp_path / "file") in found.message
    assert found.remedy.startswith("set TACTORCH_CACHE")


def test_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    found = findings("machine")
    assert "usable of" in found["cores"].message
    assert "GiB" in found["memory"].message
    monkeypatch.setattr(torch.version, "cuda", None)
    assert "built without CUDA" in finding("GPU").message
    monkeypatch.setattr(torch.version, "cuda", "12.8")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)

    def no_driver() -> None:
        raise RuntimeError("Found no NVIDIA driver on your system.")

    monkeypatch.setattr(torch.cuda, "init", no_driver)
    gpu = finding("GPU")
    assert gpu.works is None
    assert "no NVIDIA driver" in gpu.message
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch, "ones", lambda *a, **k: no_driver())
    assert finding("GPU").works is False


def test_what_packages_print_does_not_spoil_the_json(
    tactorch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def talkative() -> str:
        print("hello from a package")
        return "1"

    monkeypatch.setattr(doctor, "CHECKS", [Check("packages", name, talkative) for name in "wxyz"])
    done = tactorch("doctor", "json=true")
    assert len(json.loads(done.out)["findings"]) == 4
    assert "hello" in done.err
