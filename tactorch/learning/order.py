"""Order and randomness of training, determined by seed, epoch and step alone.

A training that is resumed from a checkpoint gives the same result as one without interruption.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import lightning
import numpy as np
import torch
from torch.utils.data import Sampler


class EpochSampler(Sampler[tuple[int, int]]):
    """Samples every place once, in an order that depends on seed and epoch alone.

    Yields pairs of epoch and place, for datasets whose augmentation depends on both. Lightning
    sets the epoch.

    Args:
        count: Number of places.
        seed: Seed of the orders.
    """

    def __init__(self, count: int, seed: int = 0) -> None:
        self.count, self.seed, self.epoch = count, seed, 0

    def set_epoch(self, epoch: int) -> None:
        """Set the number of the next epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        order = np.random.default_rng([self.seed, self.epoch]).permutation(self.count)
        return iter([(self.epoch, int(place)) for place in order])


class SeededSteps(lightning.Callback):
    """Seeds the random numbers of a network (such as dropout) at each step."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def on_train_batch_start(
        self, trainer: lightning.Trainer, module: lightning.LightningModule, *others: Any
    ) -> None:
        """Seed the step."""
        torch.manual_seed(seed_of(self.seed, trainer.global_step))


def seed_of(*words: int) -> int:
    """Return a seed derived from several integers, such as seed, epoch and place."""
    return int(np.random.SeedSequence(list(words)).generate_state(1, np.uint64)[0] >> np.uint64(1))


def scheduled_adam(
    module: lightning.LightningModule, learning_rate: float, weight_decay: float
) -> Any:
    """Return AdamW with `rise_and_fall`, as `configure_optimizers` has to."""
    optimizer = torch.optim.AdamW(module.parameters(), lr=learning_rate, weight_decay=weight_decay)
    shape = rise_and_fall(int(module.trainer.estimated_stepping_batches))
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, shape)
    return [optimizer], [{"scheduler": schedule, "interval": "step"}]


def rise_and_fall(steps: int, rise: float = 0.1) -> Callable[[int], float]:
    """Return a learning rate's share by step: rising for a share of the steps, then a cosine."""
    total = max(1, steps)
    first = max(1, round(rise * total))

    def share(step: int) -> float:
        if step < first:
            return (step + 1) / first
        return 0.5 * (1.0 + math.cos(math.pi * min(1.0, (step - first) / max(1, total - first))))

    return share
