from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import Hemisphere
from tactorch.mesh.lattice import lattice_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.touch import TouchOptions, TouchScene

SENSOR = SensorDescription(
    "small", (40, 32), (0.25, 0.25), GelLayer(2.0, 0.2, 0.45, size_mm=(11.0, 9.0)),
    MarkerGrid(5, 4, (2.0, 2.0), 0.6),
)  # fmt: skip


@pytest.fixture(scope="session")
def sensor_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor with a small gel, whose presses take a fraction of a second."""
    path = tmp_path_factory.mktemp("sensor") / "small.yaml"
    save_sensor(SENSOR, path)
    return path


@pytest.fixture(scope="session")
def make_scene(sensor_file: Path) -> Callable[..., TouchScene]:
    """Makes scenes of a hemisphere of 6 mm of a modulus (MPa)."""

    def make(youngs_mpa: float = 0.2, edge_mm: float = 3.0, **changes: Any) -> TouchScene:
        usual = {"sensor": str(sensor_file), "image_width_px": None, "gel_edge_mm": 1.8}
        options = TouchOptions(**{**usual, **changes})
        phantom = Phantom(Hemisphere((0.0, 0.0, 0.0), 6.0), (), youngs_mpa)
        mesh = lattice_mesh(phantom.body, edge_mm)
        material = MaterialSpec("neo_hookean", 0.45)
        return TouchScene(phantom, mesh, material, options.description(), options)

    return make


@pytest.fixture
def above() -> np.ndarray:
    """Pose of a sensor that looks down on the top of the hemisphere."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 6.0
    return pose
