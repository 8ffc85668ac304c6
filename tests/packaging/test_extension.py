"""A package of others adds a material, a prior and a sensor map by entry points."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tactorch import Reconstruction

SOURCE = Path(__file__).parent / "extension" / "elastic_extras.py"
Completed = subprocess.CompletedProcess[str]
METADATA = "Metadata-Version: 2.1\nName: elastic-extras\nVersion: 1\n"
ENTRY_POINTS = """\
[tactorch.material]
yeoh_extra = elastic_extras:Yeoh
[tactorch.regularization]
ridge = elastic_extras:Ridge
[tactorch.sensor_map]
affine = elastic_extras:Affine
"""
SIMULATE = """
from tactorch import MaterialSpec, PressPlan, make_phantom, simulate
from tactorch.mesh import box_mesh
material = MaterialSpec("yeoh_extra", poisson=0.45, parameters={"c": 0.3})
plan = PressPlan(["z+"], p_max_mpa=0.02, steps=1)
mesh = box_mesh(10.0, 2)
ball = make_phantom("cube_sphere", radius=0.3)
simulate(ball, plan, material=material, mesh=mesh, samples=2, snr_db=40).save("press.h5")
"""
MAP = """
import numpy as np
from tactorch.sensor.calibration import SENSOR_MAPS
rng = np.random.default_rng(0)
features, matrix = rng.random((50, 5)), rng.random((5, 2))
slope_map = SENSOR_MAPS.build("affine").create(0)
slope_map.fit(features, features @ matrix, 0)
print(np.allclose(slope_map(features), features @ matrix), "affine" in SENSOR_MAPS.names())
"""

# Each starts processes that import everything.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as pip would install it."""
    folder = tmp_path_factory.mktemp("extension")
    information = folder / "site" / "elastic_extras-1.0.dist-info"
    information.mkdir(parents=True)
    shutil.copy2(SOURCE, folder / "site")
    (information / "METADATA").write_text(METADATA)
    (information / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


def run(folder: Path, *arguments: str, installed: bool = True) -> Completed:
    path = str(folder / "site") if installed else ""
    cache = {"XDG_CACHE_HOME": str(folder / f"cache-{installed}")}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, **cache, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture(scope="module")
def used(folder: Path) -> Completed:
    """A process that uses the material and the sensor map."""
    return run(folder, "-c", SIMULATE + MAP)


@pytest.fixture(scope="module")
def press(used: Completed) -> str:
    assert used.returncode == 0, used.stderr
    return "press.h5"


def test_invert_uses_the_prior_and_the_material(folder: Path, press: str) -> None:
    """A prior of great weight holds the map at its level."""
    settings = ("regularization=ridge", "regularization.level_mpa=0.3", "regularization.weight=1e8")
    quick = ("run_dir=run", "plots=false", "method=map")
    command = ("-m", "tactorch", "invert", f"recording={press}", *quick)
    done = run(folder, *command, *settings)
    assert done.returncode == 0, done.stderr
    result = Reconstruction.load(folder / "run" / "reconstruction.h5")
    assert np.abs(result.youngs / 0.3 - 1).max() < 0.01
    assert result.config["settings"]["regularization"]["name"] == "ridge"
    assert result.config["material"]["name"] == "yeoh_extra"


def test_settings_of_the_package_are_checked_and_documented(folder: Path, press: str) -> None:
    command = ("-m", "tactorch", "invert", f"recording={press}", "regularization=ridge")
    done = run(folder, *command, "regularization.level_mpa=-1")
    assert done.returncode == 2
    assert "regularization.level_mpa=-1: give a number above 0" in done.stderr
    shown = run(folder, "-m", "tactorch", "invert", "regularization=ridge", "--help").stdout
    assert "Expected modulus" in shown


def test_without_the_package_the_names_are_unknown(folder: Path, press: str) -> None:
    command = ("-m", "tactorch", "invert", f"recording={press}", "run_dir=none")
    done = run(folder, *command, "regularization=ridge", installed=False)
    assert done.returncode == 2
    assert "regularization=ridge is unknown" in done.stderr
    done = run(folder, *command, installed=False)
    assert done.returncode == 2
    assert "yeoh_extra" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_sensor_map_is_fitted(used: Completed) -> None:
    assert used.stdout.split() == ["True", "True"], used.stderr
