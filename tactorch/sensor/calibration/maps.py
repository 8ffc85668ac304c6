"""From change of colour and place to slope: by a small network, or by a table."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import nn

from tactorch.errors import ConfigError

Arrays = dict[str, np.ndarray]
Samples = Float[np.ndarray, "_ 5"]
Slopes = Float[np.ndarray, "_ 2"]
_BATCH = 2048


@contextmanager
def _one_thread() -> Iterator[None]:
    """So small a network is slower on more, and much slower where others use the cores."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@runtime_checkable
class SlopeMap(Protocol):
    """What turns features of pixels into slopes."""

    name: str

    def fit(self, seen: Samples, slopes: Slopes, seed: int) -> None:
        """Learn, or go on learning, from pixels of known slope."""

    def __call__(self, seen: Samples) -> Slopes:
        """Return the slopes of pixels."""

    def arrays(self) -> Arrays:
        """Return what was learnt, to be stored."""

    def restore(self, arrays: Arrays) -> None:
        """Take up what was stored."""


class MlpMap:
    """A network of two hidden layers.

    Args:
        place: Whether it knows where a pixel is. With presses all over the gel that helps; with a
            few it learns by heart where those were.
        width: Of a hidden layer.
        steps: Of Adam, in each call of `fit`.
        learning_rate: At first; it falls to nothing along half a cosine.
    """

    def __init__(
        self, place: bool = True, width: int = 48, steps: int = 300, learning_rate: float = 5e-3
    ) -> None:
        self.name = "mlp" if place else "mlp_colour"
        self.steps, self.learning_rate = steps, learning_rate
        self.inputs = 5 if place else 3
        self.network = nn.Sequential(
            nn.Linear(self.inputs, width), nn.Tanh(),
            nn.Linear(width, width), nn.Tanh(),
            nn.Linear(width, 2),
        )  # fmt: skip

    def fit(self, seen: Samples, slopes: Slopes, seed: int) -> None:
        """Learn, or go on learning, from pixels of known slope."""
        with _one_thread():
            self._fit(seen, slopes, seed)

    def _fit(self, seen: Samples, slopes: Slopes, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        x, y = (torch.from_numpy(v.astype(np.float32)) for v in (seen[:, : self.inputs], slopes))
        optimizer = torch.optim.Adam(self.network.parameters(), lr=self.learning_rate)
        rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.steps)
        for _ in range(self.steps):
            rows = torch.randint(len(x), (_BATCH,), generator=generator)
            loss = (self.network(x[rows]) - y[rows]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            rate.step()

    def __call__(self, seen: Samples) -> Slopes:
        """Return the slopes of pixels."""
        with torch.inference_mode():
            own = torch.from_numpy(seen[:, : self.inputs].astype(np.float32))
            return self.network(own).double().numpy()

    def arrays(self) -> Arrays:
        """Return what was learnt, to be stored."""
        return {name: value.numpy() for name, value in self.network.state_dict().items()}

    def restore(self, arrays: Arrays) -> None:
        """Take up what was stored."""
        self.network.load_state_dict({name: torch.from_numpy(v) for name, v in arrays.items()})

    @staticmethod
    def seeded(seed: int, **settings: Any) -> "MlpMap":
        """Make one whose first weights depend on the seed alone."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return MlpMap(**settings)


class LookupMap:
    """A table over the change of the three colours, with a plane for the place.

    Each cell holds the mean slope of the pixels that fell into it; empty ones are filled from their
    neighbours. What is left is fitted by the place and its products with the colours.

    Args:
        bins: Cells for each colour.
        most: Largest change that the table reaches, in units of `change`.
    """

    name = "lookup"

    def __init__(self, bins: int = 24, most: float = 2.5) -> None:
        self.bins, self.most = bins, most
        self.table = np.zeros((bins, bins, bins, 2))
        self.plane = np.zeros((9, 2))

    def fit(self, seen: Samples, slopes: Slopes, seed: int) -> None:
        """Learn from pixels of known slope."""
        left = slopes
        self.plane = np.zeros((9, 2))
        for _ in range(3):  # table and plane in turn
            self.table = self._filled(seen, left)
            design = self._design(seen)
            rest = slopes - self._looked_up(seen)
            ridge = 1e-3 * len(seen) * np.eye(9)
            self.plane = np.linalg.solve(design.T @ design + ridge, design.T @ rest)
            left = slopes - design @ self.plane

    def __call__(self, seen: Samples) -> Slopes:
        """Return the slopes of pixels."""
        return self._looked_up(seen) + self._design(seen) @ self.plane

    def arrays(self) -> Arrays:
        """Return what was learnt, to be stored."""
        return {"table": self.table, "plane": self.plane, "most": np.array(self.most)}

    def restore(self, arrays: Arrays) -> None:
        """Take up what was stored."""
        table, plane, most = arrays["table"], arrays["plane"], arrays["most"]
        if table.shape != (len(table),) * 3 + (2,) or plane.shape != (9, 2) or not most > 0:
            raise ValueError(f"its table is {table.shape}, its plane {plane.shape}, most={most}")
        self.table, self.plane, self.bins, self.most = table, plane, len(table), float(most)

    def _places(self, seen: Samples) -> np.ndarray:
        middle = (self.bins - 1) / 2
        return np.clip(seen[:, :3] / self.most * middle + middle, 0, self.bins - 1)

    def _looked_up(self, seen: Samples) -> Slopes:
        from scipy.ndimage import map_coordinates

        places = self._places(seen).T
        return np.stack(
            [map_coordinates(self.table[..., k], places, order=1) for k in range(2)], axis=1
        )

    def _filled(self, seen: Samples, slopes: Slopes) -> np.ndarray:
        """Mean slopes of the cells, spread to empty ones by ever wider averages."""
        from scipy.ndimage import gaussian_filter

        cells = tuple(self._places(seen).round().astype(int).T)
        total, count = np.zeros(self.table.shape), np.zeros(self.table.shape[:3])
        np.add.at(total, cells, slopes)
        np.add.at(count, cells, 1.0)
        found, known = np.zeros_like(total), np.zeros(count.shape, dtype=bool)
        for width in (0.6, 1.2, 2.4, 4.8, 9.6):
            weight = gaussian_filter(count, width, mode="constant")
            mean = [gaussian_filter(total[..., k], width, mode="constant") for k in range(2)]
            new = ~known & (weight > 1e-3)
            found[new] = (np.stack(mean, axis=-1)[new]) / weight[new][:, None]
            known |= new
        return found

    def _design(self, seen: Samples) -> np.ndarray:
        """Products of place and colour, and the place itself times the change's size."""
        colour, place = seen[:, :3], seen[:, 3:]
        products = [colour * place[:, [k]] for k in range(2)]
        squares = colour * (place[:, [0]] ** 2 + place[:, [1]] ** 2)
        return np.concatenate([*products, squares], axis=1)


#: Names of the maps: a network that knows the place, one that does not, and a table.
MAPS = ("mlp", "mlp_colour", "lookup")


def make_map(name: str, seed: int = 0) -> SlopeMap:
    """Make a map that has learnt nothing yet.

    Raises:
        ConfigError: There is none of that name.
    """
    if name in ("mlp", "mlp_colour"):
        return MlpMap.seeded(seed, place=name == "mlp")
    if name != "lookup":
        raise ConfigError(f"map={name!r}: choose one of {', '.join(MAPS)}.")
    return LookupMap()
