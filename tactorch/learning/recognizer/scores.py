"""Scores of a classifier's probabilities."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError


@dataclass(frozen=True, eq=False)
class ClassScores:
    """Scores of n answers among c classes.

    Attributes:
        confusion: (c, c) counts, a row per true class.
        accuracy: Share of right answers.
        precision: Precision of each class, (c,); NaN where it was never predicted.
        recall: Recall of each class, (c,); NaN where it never occurred.
        f1: Harmonic mean of both.
        calibration_error: Mean gap between stated probability and share of right answers, by
            tenths of the probability (Guo et al., 2017).
        confidence: Mean probability of the named class in each tenth, (10,); NaN in empty ones.
        right: Share of right answers in each tenth, (10,).
        counts: Answers in each tenth, (10,).
    """

    confusion: Int[np.ndarray, "c c"]
    accuracy: float
    precision: Float[np.ndarray, " c"]
    recall: Float[np.ndarray, " c"]
    f1: Float[np.ndarray, " c"]
    calibration_error: float
    confidence: Float[np.ndarray, " b"]
    right: Float[np.ndarray, " b"]
    counts: Int[np.ndarray, " b"]


def class_scores(
    probabilities: Float[np.ndarray, "n c"], truth: Int[np.ndarray, " n"], bins: int = 10
) -> ClassScores:
    """Score probabilities against the true classes.

    Raises:
        ConfigError: There is nothing to score, or a class is out of range.
    """
    count, classes = probabilities.shape
    if count == 0 or truth.min() < 0 or truth.max() >= classes:
        raise ConfigError(f"{count} answers among {classes} classes do not fit the true classes.")
    named = probabilities.argmax(axis=1)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    np.add.at(confusion, (truth, named), 1)
    hits = np.diag(confusion).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision, recall = hits / confusion.sum(axis=0), hits / confusion.sum(axis=1)
        f1 = 2.0 * hits / (confusion.sum(axis=0) + confusion.sum(axis=1))
        stated = probabilities.max(axis=1)
        place = np.minimum((stated * bins).astype(int), bins - 1)
        counts = np.bincount(place, minlength=bins)
        confidence = np.bincount(place, stated, minlength=bins) / counts
        right = np.bincount(place, named == truth, minlength=bins) / counts
    gaps = np.nansum(counts * np.abs(confidence - right)) / count
    accuracy = float(hits.sum() / count)
    return ClassScores(
        confusion, accuracy, precision, recall, f1, float(gaps), confidence, right, counts
    )
