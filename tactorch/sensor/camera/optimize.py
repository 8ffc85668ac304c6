"""Minimization of functions of named tensors by gradients (L-BFGS, Nocedal 1980)."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

_HISTORY = 30
_TOLERANCE = 1e-10

Parameters = Mapping[str, Tensor]


def minimize(
    loss: Callable[[Parameters], Tensor],
    start: Parameters,
    scales: Mapping[str, float | Tensor],
    iterations: int,
) -> tuple[dict[str, Tensor], float]:
    """Minimize a loss over the tensors that have a scale, from their start values.

    Args:
        loss: Function of all tensors by name.
        start: Start values; those without a scale are kept.
        scales: Typical size of the change of a tensor, by which it is divided.
        iterations: Largest number of iterations.

    Returns:
        The tensors at the smallest loss found, and this loss. Where the loss is not finite, the
        line search steps back.
    """
    first = next(iter(start.values()))
    variables = {
        name: torch.zeros_like(start[name], requires_grad=True, device=first.device)
        for name in scales
    }
    optimizer = torch.optim.LBFGS(
        list(variables.values()), max_iter=iterations, history_size=_HISTORY,
        line_search_fn="strong_wolfe", tolerance_change=_TOLERANCE,
    )  # fmt: skip
    best: tuple[float, dict[str, Tensor]] = (float("inf"), {})

    def tensors() -> dict[str, Tensor]:
        moved = {name: start[name].detach() + scales[name] * x for name, x in variables.items()}
        return {**{name: value.detach() for name, value in start.items()}, **moved}

    def closure() -> Tensor:
        nonlocal best
        optimizer.zero_grad()
        current = tensors()
        value = loss(current)
        if float(value.detach()) < best[0]:
            best = float(value.detach()), {name: t.detach().clone() for name, t in current.items()}
        value.backward()
        return value

    optimizer.step(closure)
    return best[1], best[0]
