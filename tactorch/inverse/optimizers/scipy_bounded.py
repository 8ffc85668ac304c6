"""The common part of SciPy's bounded gradient methods."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective, Point

_REFUSED = 1e3  # objective of a map without equilibrium, relative to the start's


@dataclass(eq=False)
class BoundedRun:
    """One run of `scipy.optimize.minimize` with the adjoint gradient.

    A map at which some press has no equilibrium gets a large value, so that line searches turn
    back. The lowest point seen is the monitor's best.
    """

    objective: Objective
    monitor: Monitor
    weight: float
    lowest: float = np.inf
    point: Point | None = None
    _latest: list[Point] = field(default_factory=list)

    def run(
        self,
        method: str,
        start: Float[np.ndarray, " m"],
        options: dict[str, Any],
    ) -> Any:
        """Minimise from `start`; returns SciPy's result."""
        self._value(start, strict=True)
        limits = self.objective.parameterization.limits

        return minimize(
            self._value,
            start,
            jac=True,
            method=method,
            bounds=[limits] * len(start),
            callback=lambda _: self._report(),
            options=options,
        )

    def _value(self, x: np.ndarray, strict: bool = False) -> tuple[float, np.ndarray]:
        near = self._latest[-1] if self._latest else None
        if near is not None and np.array_equal(near.x, x):
            return near.value(self.weight), self._gradient(near)
        try:
            point = self.objective.at(x.copy(), near)
        except ConvergenceError:
            if strict or near is None:
                raise
            return _REFUSED * max(self.lowest, 1.0), self._gradient(near)
        self._latest = [point]
        value = point.value(self.weight)
        if value < self.lowest:
            self.lowest, self.point = value, point
        if strict and not self.monitor.history:
            self._report()
        self.monitor.check_time()
        return value, self._gradient(point)

    def _gradient(self, point: Point) -> np.ndarray:
        if self.weight == 0.0:
            return point.data_gradient
        return point.data_gradient + self.weight * point.penalty_gradient

    def _report(self) -> None:
        """Report the lowest point, once an iteration."""
        assert self.point is not None
        before = self.monitor.best
        step = 0.0 if before is None else float(np.abs(self.point.x - before).max())
        self.monitor.accept(self.point, objective=self.lowest, weight=self.weight, step=step)
