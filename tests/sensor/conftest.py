from collections.abc import Callable

import numpy as np
import pytest

from tactorch.sensor.description import GelLayer, SensorDescription

MakeSensor = Callable[..., SensorDescription]


@pytest.fixture
def make_sensor() -> MakeSensor:
    """A small sensor: 64 x 48 px of 0.3 mm."""

    def make(**changes: object) -> SensorDescription:
        fields = {"name": "small", "image_size_px": (64, 48), "mm_per_px": (0.3, 0.3)}
        fields["gel"] = GelLayer(3.0, 0.2, size_mm=(20.0, 16.0))
        return SensorDescription(**{**fields, **changes})

    return make


@pytest.fixture
def gel_image() -> np.ndarray:
    """A gel without contact: coloured light that falls off, and some noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:48, :64]
    light = np.stack([120 + x, 120 + y, 160 - 0.5 * x], axis=2)
    return np.clip(light + rng.normal(0, 1.5, light.shape), 0, 255).astype(np.uint8)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(6)
