"""Rigid probes as signed distances in their own axes, differentiable to any order.

A probe pushes along its -z axis. The distance is negative within the probe.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError

_ROUND_OFF = 1e-30  # mm^2, added below the square root, whose derivative at zero is not finite


class Probe(Options, ABC):
    """A rigid body that is pressed into a soft one.

    The fields of a subclass are its sizes in mm, in the order of `sizes`.
    """

    section: ClassVar[str] = "probe"

    @property
    def sizes(self) -> tuple[float, ...]:
        """Sizes, mm."""
        return tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    @abstractmethod
    def distance(
        self, points: Float[Tensor, "k 3"], sizes: Float[Tensor, " s"]
    ) -> Float[Tensor, " k"]:
        """Return the signed distance from the surface, mm.

        Args:
            points: Positions in the probe's axes, mm.
            sizes: Sizes, mm: those of the probe, or others that are differentiated.
        """


@dataclass(frozen=True)
class Ball(Probe):
    """A ball, whose position is that of its centre."""

    radius_mm: float = option(help="Radius of the ball", unit="mm", gt=0)

    def distance(self, points: Tensor, sizes: Tensor) -> Tensor:  # noqa: D102
        return _length(points) - sizes[0]


@dataclass(frozen=True)
class Cylinder(Probe):
    """A long cylinder along the x axis, whose position is on its axis."""

    radius_mm: float = option(help="Radius of the cylinder", unit="mm", gt=0)

    def distance(self, points: Tensor, sizes: Tensor) -> Tensor:  # noqa: D102
        return _length(points[:, 1:]) - sizes[0]


@dataclass(frozen=True)
class FlatPunch(Probe):
    """A round bar along z with a flat end, whose position is the middle of the end."""

    radius_mm: float = option(help="Radius of the bar", unit="mm", gt=0)
    edge_mm: float = option(0.0, "Radius to which the edge of the end is rounded", unit="mm", ge=0)

    def __post_init__(self) -> None:
        """Check the sizes.

        Raises:
            ConfigError: a size is not positive, or the edge's radius exceeds the bar's.
        """
        super().__post_init__()
        if self.edge_mm > self.radius_mm:
            raise ConfigError(
                f"probe.edge_mm={self.edge_mm} exceeds probe.radius_mm={self.radius_mm}; round the "
                "edge by less than the radius."
            )

    def distance(self, points: Tensor, sizes: Tensor) -> Tensor:  # noqa: D102
        radius, edge = sizes[0], sizes[1]
        # Distance from a bar with sharp edges that is smaller by the radius of the edge.
        across, along = _length(points[:, :2]) - radius + edge, edge - points[:, 2]
        outside = _length(torch.stack([across, along], dim=1).clamp(min=0.0))
        return outside + torch.maximum(across, along).clamp(max=0.0) - edge


def _length(vectors: Float[Tensor, "k d"]) -> Float[Tensor, " k"]:
    """Return Euclidean lengths, with finite derivatives at zero."""
    return ((vectors**2).sum(1) + _ROUND_OFF).sqrt()


#: Probes by name.
PROBES = Registry(
    "probe",
    {
        "ball": "tactorch.fem.contact.probes:Ball",
        "flat": "tactorch.fem.contact.probes:FlatPunch",
        "cylinder": "tactorch.fem.contact.probes:Cylinder",
    },
)
