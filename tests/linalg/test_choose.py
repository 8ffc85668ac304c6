import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.linalg import SOLVERS, SolverPool, SymmetricPattern, analyse, available_solvers
from tactorch.linalg.iterative import Multigrid, TorchCG
from tactorch.linalg.pardiso import Pardiso


def ring(size: int) -> SymmetricPattern:
    return SymmetricPattern.from_pairs(size, np.arange(size), np.roll(np.arange(size), 1))


def test_unknown_solver_is_refused_by_name_with_the_choices():
    with pytest.raises(ConfigError, match=r"cholmod.*pardiso.*superlu.*multigrid"):
        analyse(ring(4), "cholmod")


def test_pardiso_without_its_library_is_refused_with_the_remedy(monkeypatch):
    monkeypatch.setattr(Pardiso, "available", staticmethod(lambda: False))
    with pytest.raises(ConfigError, match=r"solver=pardiso.*pip install pypardiso"):
        analyse(ring(4), "pardiso")
    assert "pardiso" not in available_solvers()


@pytest.mark.parametrize(
    ("installed", "size", "expected"),
    [
        (True, 1_000, "pardiso"),
        (True, 2_000_000, "multigrid"),
        (False, 1_000, "superlu"),
        (False, 100_000, "multigrid"),
    ],
)
def test_auto_depends_on_what_is_installed_and_on_the_size(monkeypatch, installed, size, expected):
    monkeypatch.setattr(Pardiso, "available", staticmethod(lambda: installed))
    resolved = SOLVERS["auto"]().resolve(size)
    assert SOLVERS.name_of(type(resolved)) == expected


@pytest.mark.parametrize("name", available_solvers())
def test_a_pool_analyses_with_the_chosen_solver(name):
    pool = SolverPool(ring(9), name)
    assert isinstance(pool.options, SOLVERS[name])
    assert type(pool.take()) is type(analyse(ring(9), name))


def test_settings_of_a_solver_are_checked_by_name():
    with pytest.raises(ConfigError, match=r"solver.max_iterations=0.*at least 1"):
        Multigrid(max_iterations=0)
    with pytest.raises(ConfigError, match=r"solver.device=cuda:9.*CUDA"):
        TorchCG(device="cuda:9").analyse(ring(9))


def test_every_available_solver_is_a_known_one():
    assert set(available_solvers()) < set(SOLVERS.names())
