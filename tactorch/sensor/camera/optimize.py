"""Fit of the parameters of a module by gradients (L-BFGS, Nocedal 1980)."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

_HISTORY = 30
_TOLERANCE = 1e-10


def fit_parameters(
    module: nn.Module,
    loss: Callable[[], Tensor],
    scales: Mapping[str, float],
    iterations: int,
    ridge: float,
) -> None:
    """Set the parameters of a module that have a scale to where a loss is smallest.

    The start is the present parameters. Where the loss is not finite, the line search steps back.
    `scales` are typical sizes of the changes of the parameters that are fitted, and `ridge` is the
    weight of the squared changes over their scales.
    """
    parameters = [module.get_parameter(name) for name in scales]
    start = [parameter.detach().clone() for parameter in parameters]
    changes = [torch.zeros_like(values) for values in start]
    rows = list(zip(parameters, start, changes, scales.values(), strict=True))
    optimizer = torch.optim.LBFGS(
        changes, max_iter=iterations, history_size=_HISTORY, line_search_fn="strong_wolfe",
        tolerance_change=_TOLERANCE,
    )  # fmt: skip
    best, best_values = float("inf"), start

    def closure() -> Tensor:
        nonlocal best, best_values
        with torch.no_grad():
            for parameter, values, change, scale in rows:
                parameter.copy_(values + scale * change)
        value = loss() + ridge * torch.cat([change.flatten() for change in changes]).square().sum()
        if float(value.detach()) < best:
            best, best_values = float(value.detach()), [p.detach().clone() for p in parameters]
        slopes = torch.autograd.grad(value, parameters)
        for (_, _, change, scale), slope in zip(rows, slopes, strict=True):
            change.grad = (scale * slope + 2.0 * ridge * change).contiguous()
        return value

    optimizer.step(closure)
    with torch.no_grad():
        for parameter, values in zip(parameters, best_values, strict=True):
            parameter.copy_(values)
