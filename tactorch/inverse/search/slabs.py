"""Matched filter for slabs: parts of a body between two planes across an axis.

A slab that ends within the body at one plane is a step of the background, one between two planes a
cuboid. Both are proposed where they would reduce the misfit most.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.fields import (
    FAMILIES,
    Cloud,
    InclusionShape,
    ShapeField,
    ShapePrior,
    Sites,
    Vector,
)
from tactorch.inverse.fields.background import beyond
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import (
    MIN_CANDIDATE_GAIN,
    Model,
    Start,
    replaced,
    start_contrast,
    with_step,
)

_PLANES, _MAX_STEPS = 15, 4  # planes across an axis, and steps of a background
_THICKEST = 0.5  # of a cuboid, over the extent of the body
_WIDE = 0.92  # width of a cuboid over that of the body
_ACROSS, _END = 0.8, 0.1  # width of a plate, and its distance from an end, over the body's
_POINTS = 6  # of a cloud along each axis


def slabs(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with the best step, and with the best cuboid, across any axis."""
    data, field = problem.data(model.errors), model.fit.field
    basis, _ = np.linalg.qr(data.whiten(problem.jacobian(model)))
    residuals = data.whiten(problem.raw(model).residuals)
    found = [
        slab
        for axis in sorted({"xyz".index(side[0]) for side in problem.step_sides})
        for slab in _slabs(axis, *_responses(problem, data, axis), residuals, basis)
    ]
    thin = [slab for slab in found if slab.gain >= MIN_CANDIDATE_GAIN]
    steps = [slab for slab in thin if slab.side in problem.step_sides]
    if steps and len(field.background.steps) < _MAX_STEPS:
        best = max(steps, key=lambda slab: slab.gain)
        yield Start(f"step, {best.what}", *_with_step(field, model.fit.z, best), model.errors)
    if thin and len(field.families) < problem.max_shapes and "cuboid" in problem.forms:
        yield _with_cuboid(model, max(thin, key=lambda slab: slab.gain))


class _Slab(NamedTuple):
    """What is between two planes; at least one of them is within the body."""

    axis: int
    low: float | None  # mm; None at the end of the body
    high: float | None
    log_contrast: float
    gain: float  # linearised

    @property
    def side(self) -> str | None:
        """Side of the body at which it ends, if that is one."""
        if (self.low is None) == (self.high is None):
            return None
        return "xyz"[self.axis] + ("-" if self.low is None else "+")

    @property
    def what(self) -> str:
        ends = zip((">", "<"), (self.low, self.high), strict=True)
        name = "xyz"[self.axis]
        return " and ".join(f"{name} {sign} {end:.3g} mm" for sign, end in ends if end is not None)


def _slabs(
    axis: int,
    planes: Float[np.ndarray, " planes"],
    responses: Float[np.ndarray, "data planes"],
    residuals: Float[np.ndarray, " data"],
    basis: Float[np.ndarray, "data k"],
) -> Iterator[_Slab]:
    """Yield the slabs across an axis of up to half the extent of the body."""
    responses = responses - basis @ (basis.T @ responses)
    products, squares = residuals @ responses, responses.T @ responses
    for i, j in combinations(range(len(planes)), 2):
        if j - i <= _THICKEST * len(planes):
            square = squares[i, i] + squares[j, j] - 2.0 * squares[i, j] + 1e-12
            contrast = (products[i] - products[j]) / square
            low = None if i == 0 else float(planes[i])
            high = None if j == len(planes) - 1 else float(planes[j])
            gain = float(0.5 * contrast**2 * square)
            yield _Slab(axis, low, high, start_contrast(float(contrast)), gain)


def _responses(
    problem: SearchProblem, data: DataModel, axis: int
) -> tuple[Float[np.ndarray, " planes"], Float[np.ndarray, "data planes"]]:
    """Return planes (mm) from end to end of the body, and the changes of what is below them."""
    mesh = problem.reduced.recording.mesh
    low, high = mesh.bounds
    planes, sites = np.linspace(low[axis], high[axis], _PLANES + 2), Sites.around(mesh)
    below = [beyond(f"{'xyz'[axis]}-", float(plane), sites)[0] for plane in planes]
    below[0], below[-1] = 0.0 * below[0], 0.0 * below[-1] + 1.0
    rates = np.asarray(problem.reduced.rates @ np.stack(below, axis=1))
    return planes, data.whiten(rates * data.scale[:, None])


def _with_step(field: ShapeField, z: Vector, slab: _Slab) -> tuple[ShapeField, np.ndarray]:
    place = slab.high if slab.low is None else slab.low
    assert slab.side is not None
    assert place is not None
    return with_step(field, z, slab.side, place, slab.log_contrast)


def crosses(shape: InclusionShape, prior: ShapePrior) -> bool:
    """Whether an inclusion is nearly as wide as the body along two axes."""
    return int((2.0 * shape.half_size_mm > _ACROSS * (prior.high_mm - prior.low_mm)).sum()) > 1


def inclusions_as_steps(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with each plate at an end of the body as a step of its background."""
    fit = model.fit
    for k, shape in enumerate(fit.field.shapes(fit.z)):
        if fit.field.families[k].name == "cuboid" and crosses(shape, fit.field.prior):
            slab = _slab_like(shape, fit.field.prior)
            if slab.side in problem.step_sides:
                step = _with_step(*replaced(fit, [k], (), []), slab)
                yield Start(f"inclusion {k} as a step", *step, model.errors)


def _slab_like(shape: InclusionShape, prior: ShapePrior) -> _Slab:
    """Return the slab that resembles a plate."""
    extent = prior.high_mm - prior.low_mm
    axis = int(np.argmin(shape.half_size_mm / extent))
    center, half = shape.center_mm[axis], shape.half_size_mm[axis]
    low, high = float(center - half), float(center + half)
    near = prior.low_mm + _END * extent, prior.high_mm - _END * extent
    return _Slab(
        axis, low if low > near[0][axis] else None, high if high < near[1][axis] else None,
        float(np.log(shape.contrast)), 0.0,
    )  # fmt: skip


def _with_cuboid(model: Model, slab: _Slab) -> Start:
    """Return the model with a slab as a cuboid, nearly as wide as the body."""
    prior = model.fit.field.prior
    margin = 0.5 * (1.0 - _WIDE) * (prior.high_mm - prior.low_mm)
    low, high = prior.low_mm + margin, prior.high_mm - margin
    low[slab.axis] = prior.low_mm[slab.axis] if slab.low is None else slab.low
    high[slab.axis] = prior.high_mm[slab.axis] if slab.high is None else slab.high
    ticks = (np.arange(_POINTS) + 0.5) / _POINTS
    unit = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    log_radius = float(np.log(0.75 / np.pi * (high - low).prod()) / 3.0)
    cloud = Cloud(low + (high - low) * unit, log_radius, slab.log_contrast)
    cuboid = FAMILIES["cuboid"]
    added = replaced(model.fit, (), (cuboid,), [cuboid.like(cloud)])
    return Start(f"cuboid, {slab.what}", *added, model.errors)


def simpler_background(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model without what its background varies by, which inclusions may explain."""
    fit, background = model.fit, model.fit.field.background
    if background.degree and fit.field.families:
        uniform = fit.field.changed(fit.z, background=replace(background, degree=0))
        yield Start("background of degree 0", *uniform, model.errors)
    for k, side in enumerate(background.steps):
        kept = tuple(other for i, other in enumerate(background.steps) if i != k)
        field = replace(fit.field, background=replace(background, steps=kept))
        values = np.delete(fit.field.physical(fit.z), background.step_at(k))
        yield Start(f"step {k} at {side} removed", field, field.standard(values), model.errors)
