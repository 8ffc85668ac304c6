"""The common part of SciPy's bounded gradient methods."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Point

_REFUSED = 1e3  # objective of a map without equilibrium, relative to the start's


@dataclass(eq=False)
class BoundedRun:
    """One run of `scipy.optimize.minimize` with the adjoint gradient.

    A map at which some press has no equilibrium gets a large value, so that line searches turn
    back. The lowest point seen is the monitor's best, however the run ends.

    Attributes:
        point: The start; then the lowest point seen.
        monitor: Whom to report to.
        weight: Weight of the prior.
    """

    point: Point
    monitor: Monitor
    weight: float

    def run(self, method: str, options: dict[str, Any]) -> Any:
        """Minimise from `point`; returns SciPy's result.

        Raises:
            StopOptimization: raised by the monitor.
        """
        objective, start = self.point.objective, self.point.x
        self._latest = self.point
        if not self.monitor.history:
            self._report()
        try:
            return minimize(
                self._value,
                start,
                jac=True,
                method=method,
                bounds=np.column_stack(objective.limits),
                callback=lambda _: self._report(),
                options=options,
            )
        finally:
            if self.point is not self.monitor.point and self.point.x is not start:
                self._keep()

    def _value(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        near = self._latest
        if np.array_equal(near.x, x):
            return near.value(self.weight), self._gradient(near)
        self.monitor.check_time()
        try:
            point = near.objective.at(x.copy(), near)
            gradient = self._gradient(point)
        except ConvergenceError:
            return _REFUSED * max(self._lowest, 1.0), self._gradient(near)
        self._latest = point
        if point.value(self.weight) < self._lowest:
            self.point = point
        return point.value(self.weight), gradient

    @property
    def _lowest(self) -> float:
        return self.point.value(self.weight)

    def _gradient(self, point: Point) -> np.ndarray:
        return point.data_gradient + point.prior_gradient(self.weight)

    def _report(self) -> None:
        """Report the lowest point, once an iteration."""
        self._keep()
        self.monitor.check_time()

    def _keep(self) -> None:
        before = self.monitor.best
        step = 0.0 if before is None else float(np.abs(self.point.x - before).max())
        self.monitor.keep(self.point, objective=self._lowest, weight=self.weight, step=step)
