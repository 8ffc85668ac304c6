"""Change of color in images, and the registry of maps from change and position to slope.

A further map is an `Options` class derived from `SensorMap` in a separate file, and one line in
`SENSOR_MAPS`; other packages add theirs by the entry point group `tactorch.sensor_map`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter, map_coordinates
from torch import nn

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError
from tactorch.sensor.depth import fill_masked
from tactorch.sensor.frames import Image
from tactorch.sensor.light import COLOUR_UNIT, LightChange, light_change
from tactorch.sensor.markers import MarkerAppearance, marker_mask

Arrays = dict[str, np.ndarray]
Features = Float[np.ndarray, "_ 5"]  # change of the three colors, and position x, y
Slopes = Float[np.ndarray, "_ 2"]
_BATCH = 2048
_ACTIVATION_HELP = "Activation; silu extrapolates to steeper slopes, tanh levels off"
_ACTIVATIONS: dict[str, type[nn.Module]] = {"silu": nn.SiLU, "tanh": nn.Tanh}

#: Maps from colors to slopes by name.
SENSOR_MAPS = Registry(
    "sensor_map",
    {
        "mlp": "tactorch.sensor.calibration.maps:Mlp",
        "mlp_colour": "tactorch.sensor.calibration.maps:MlpColour",
        "lookup": "tactorch.sensor.calibration.maps:Lookup",
        "camera": "tactorch.sensor.calibration.camera:CameraLight",
    },
)


def marker_pixels(
    image: Image, reference: Image, markers: MarkerAppearance | None
) -> Bool[np.ndarray, "h w"]:
    """Return the pixels covered by markers in an image or in the reference."""
    if markers is None:
        return np.zeros(image.shape[:2], dtype=bool)
    covered = marker_mask(image, markers) | marker_mask(reference, markers)
    size = 2 * max(1, round(0.15 * markers.diameter_px)) + 1  # includes blurred edges
    return cv2.dilate(covered.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def image_change(
    image: Image, reference: Image, markers: MarkerAppearance | None = None, smooth_px: float = 1.0
) -> Float[np.ndarray, "h w 3"]:
    """Return the smoothed change of each color in units of 50 gray values.

    The change is relative to that of the gel without contact, see `light_change`.

    Args:
        image: Frame.
        reference: Image of the gel without contact.
        markers: Appearance of markers, whose pixels are filled in; None without markers.
        smooth_px: Standard deviation of the smoothing.
    """
    return change_and_light(image, reference, markers, smooth_px)[0]


def change_and_light(
    image: Image, reference: Image, markers: MarkerAppearance | None = None, smooth_px: float = 1.0
) -> tuple[Float[np.ndarray, "h w 3"], LightChange]:
    """Return the change of each color, see `image_change`, and that of the light."""
    if image.shape != reference.shape:
        raise ConfigError(
            f"the image has shape {image.shape}, the reference {reference.shape}; give rectified"
            " images of one sensor."
        )
    known = ~marker_pixels(image, reference, markers)
    values = image.astype(np.float64), reference.astype(np.float64)
    light = light_change(*values, known)
    change = fill_masked(light.remove(*values) / COLOUR_UNIT, known)
    if smooth_px > 0:
        change = np.asarray(cv2.GaussianBlur(change, (0, 0), smooth_px))
    return change, light


def pixel_features(change: Float[np.ndarray, "h w 3"]) -> Features:
    """Return the change and the position, from -1 to 1 across the image, of each pixel."""
    rows, columns = change.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    position = np.stack([2 * x / (columns - 1) - 1, 2 * y / (rows - 1) - 1], axis=-1)
    return np.concatenate([change, position], axis=-1).reshape(-1, 5)


@runtime_checkable
class SlopeMap(Protocol):
    """Map from features of pixels to slopes."""

    @property
    def options(self) -> "SensorMap":
        """Settings of the map."""

    def fit(self, features: Features, slopes: Slopes, seed: int) -> None:
        """Fit, or continue to fit, to pixels of known slope."""

    def __call__(self, features: Features) -> Slopes:
        """Return the slopes of pixels."""

    def arrays(self) -> Arrays:
        """Return the fitted parameters."""

    def restore(self, arrays: Arrays) -> None:
        """Set the fitted parameters."""


@dataclass(frozen=True)
class SensorMap(Options, ABC):
    """Settings of a map; `create` returns the map, to be fitted.

    Attributes:
        contacts_by: Name of the map that finds the contacts; None for this map itself.
        automatic: Whether the map is a candidate of an automatic selection.
    """

    section: ClassVar[str] = "sensor_map"
    contacts_by: ClassVar[str | None] = None
    automatic: ClassVar[bool] = True

    @property
    def uses_position(self) -> bool:
        """Whether slopes depend on the position of a pixel, not on its color alone."""
        return True

    @abstractmethod
    def create(self, seed: int) -> SlopeMap:
        """Return a map with initial parameters of a seed, that is not fitted."""


def map_slopes(slope_map: SlopeMap, change: Float[np.ndarray, "h w 3"]) -> np.ndarray:
    """Return the slopes (h, w, 2) of an image by a map."""
    return slope_map(pixel_features(change)).reshape(*change.shape[:2], 2)


@dataclass(frozen=True)
class Mlp(SensorMap):
    """Network of two hidden layers."""

    position: bool = option(
        True, "Use the position of pixels, which helps with presses all over the gel"
    )
    width: int = option(48, "Width of the hidden layers", ge=1, le=4096)
    steps: int = option(300, "Steps of Adam in each round", ge=1)
    learning_rate: float = option(5e-3, "Initial learning rate, annealed to zero", gt=0)
    activation: Literal["silu", "tanh"] = option("tanh", _ACTIVATION_HELP)

    @property
    def uses_position(self) -> bool:
        """Whether slopes depend on the position of a pixel."""
        return self.position

    def create(self, seed: int) -> SlopeMap:
        """Return a network with initial weights that depend on the seed only."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return _MlpMap(self)


@dataclass(frozen=True)
class MlpColour(Mlp):
    """Network of two hidden layers without the position, for few presses."""

    position: bool = option(False, "Use the position of pixels")
    activation: Literal["silu", "tanh"] = option("silu", _ACTIVATION_HELP)


@dataclass(frozen=True)
class Lookup(SensorMap):
    """Table over the change of the three colors, with a correction by the position."""

    bins: int = option(24, "Cells per color", ge=2, le=128)
    max_change: float = option(
        2.5, "Largest change of color in the table, in units of 50 gray values", gt=0
    )

    def create(self, seed: int) -> SlopeMap:
        """Return an empty table."""
        return _LookupMap(self)


class _MlpMap:
    def __init__(self, options: Mlp) -> None:
        self.options = options
        self._inputs, width = 5 if options.position else 3, options.width
        activation = _ACTIVATIONS[options.activation]
        self.network = nn.Sequential(
            nn.Linear(self._inputs, width), activation(),
            nn.Linear(width, width), activation(),
            nn.Linear(width, 2),
        )  # fmt: skip

    def fit(self, features: Features, slopes: Slopes, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        inputs = features[:, : self._inputs]
        x, y = (torch.from_numpy(v.astype(np.float32)) for v in (inputs, slopes))
        optimizer = torch.optim.Adam(self.network.parameters(), lr=self.options.learning_rate)
        scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.options.steps)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # fastest for small networks on shared cores
        try:
            for _ in range(self.options.steps):
                rows = torch.randint(len(x), (_BATCH,), generator=generator)
                loss = (self.network(x[rows]) - y[rows]).square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                scheduler.step()
        finally:
            torch.set_num_threads(threads)

    def __call__(self, features: Features) -> Slopes:
        with torch.inference_mode():
            x = torch.from_numpy(features[:, : self._inputs].astype(np.float32))
            return self.network(x).double().numpy()

    def arrays(self) -> Arrays:
        return {name: value.numpy() for name, value in self.network.state_dict().items()}

    def restore(self, arrays: Arrays) -> None:
        self.network.load_state_dict({name: torch.from_numpy(v) for name, v in arrays.items()})


class _LookupMap:
    """Slope map of `Lookup`.

    Each cell holds the mean slope of its pixels; empty cells are filled from their neighbors. The
    residual is fitted by products of position and color.
    """

    def __init__(self, options: Lookup) -> None:
        self.options, self._max_change = options, options.max_change
        self.table = np.zeros((options.bins, options.bins, options.bins, 2))
        self.weights = np.zeros((9, 2))

    def fit(self, features: Features, slopes: Slopes, seed: int) -> None:
        target = slopes
        for _ in range(3):  # table and correction alternately
            self.table = self._mean_slopes(features, target)
            design = self._design(features)
            residual = slopes - self._table_slopes(features)
            ridge = 1e-3 * len(features) * np.eye(9)
            self.weights = np.linalg.solve(design.T @ design + ridge, design.T @ residual)
            target = slopes - design @ self.weights

    def __call__(self, features: Features) -> Slopes:
        return self._table_slopes(features) + self._design(features) @ self.weights

    def arrays(self) -> Arrays:
        return {"table": self.table, "plane": self.weights, "most": np.array(self._max_change)}

    def restore(self, arrays: Arrays) -> None:
        table, weights, max_change = arrays["table"], arrays["plane"], arrays["most"]
        if table.shape != (len(table),) * 3 + (2,) or weights.shape != (9, 2) or not max_change > 0:
            raise ValueError(
                f"table of shape {table.shape}, correction of shape {weights.shape}, largest change"
                f" {max_change}"
            )
        self.table, self.weights, self._max_change = table, weights, float(max_change)

    def _table_coordinates(self, features: Features) -> np.ndarray:
        center = (len(self.table) - 1) / 2
        return np.clip(features[:, :3] / self._max_change * center + center, 0, 2 * center)

    def _table_slopes(self, features: Features) -> Slopes:
        cells = self._table_coordinates(features).T
        return np.stack([map_coordinates(self.table[..., k], cells, order=1) for k in (0, 1)], 1)

    def _mean_slopes(self, features: Features, slopes: Slopes) -> np.ndarray:
        """Mean slopes of the cells; empty cells take wider and wider averages."""
        cells = tuple(self._table_coordinates(features).round().astype(int).T)
        sums = np.zeros((*self.table.shape[:3], 3))  # of slopes, and number of pixels
        np.add.at(sums, cells, np.column_stack([slopes, np.ones(len(slopes))]))
        table, known = np.zeros(self.table.shape), np.zeros(self.table.shape[:3], dtype=bool)
        for width in (0.6, 1.2, 2.4, 4.8, 9.6):
            smooth = gaussian_filter(sums, (width, width, width, 0.0), mode="constant")
            new = ~known & (smooth[..., 2] > 1e-3)
            table[new] = smooth[new, :2] / smooth[new, 2:]
            known |= new
        return table

    def _design(self, features: Features) -> np.ndarray:
        """Products of color with position and with squared distance from the center."""
        color, position = features[:, :3], features[:, 3:]
        products = [color * position[:, [k]] for k in range(2)]
        squares = color * (position[:, [0]] ** 2 + position[:, [1]] ** 2)
        return np.concatenate([*products, squares], axis=1)
