"""Networks trained on simulated presses: a recognizer of inclusions and a surrogate for starts."""

from tactorch.learning.samples import TouchDataset, collate_touch

__all__ = ["TouchDataset", "collate_touch"]
