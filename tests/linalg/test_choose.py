import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.linalg import BACKENDS, SymmetricPattern, analyse, available, choose, pardiso


def ring(size: int) -> SymmetricPattern:
    return SymmetricPattern.from_pairs(size, np.arange(size), np.roll(np.arange(size), 1))


def test_unknown_backend_is_refused_by_name_with_the_choices():
    with pytest.raises(ConfigError, match=r"cholmod.*pardiso.*superlu.*multigrid"):
        analyse(ring(4), "cholmod")


def test_pardiso_without_its_library_is_refused_with_the_way_out(monkeypatch):
    monkeypatch.setattr(pardiso, "available", lambda: False)
    with pytest.raises(ConfigError, match="pip install pypardiso"):
        analyse(ring(4), "pardiso")
    assert "pardiso" not in available()


@pytest.mark.parametrize(
    ("installed", "size", "expected"),
    [
        (True, 1_000, "pardiso"),
        (True, 2_000_000, "multigrid"),
        (False, 1_000, "superlu"),
        (False, 100_000, "multigrid"),
    ],
)
def test_auto_goes_by_what_is_installed_and_by_size(monkeypatch, installed, size, expected):
    monkeypatch.setattr(pardiso, "available", lambda: installed)
    assert choose.resolve("auto", size) == expected


@pytest.mark.parametrize("name", available())
def test_analyse_returns_the_backend_asked_for(name):
    assert analyse(ring(9), name).name == name


def test_every_available_backend_is_a_known_one():
    assert set(available()) < set(BACKENDS)
