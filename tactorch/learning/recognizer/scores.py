"""Scores of a classifier's probabilities."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError


class ClassScores(NamedTuple):
    """Scores of n predictions of c classes.

    Attributes:
        confusion: Counts by true (row) and predicted (column) class, (c, c).
        accuracy: Fraction of correct predictions.
        precision: Precision of each class, (c,); NaN if it was never predicted.
        recall: Recall of each class, (c,); NaN if it never occurred.
        f1: Harmonic mean of precision and recall, (c,).
        calibration_error: Expected calibration error (Guo et al., 2017).
        bin_confidence: Mean probability of the predicted class in each bin of the probability,
            (b,); NaN in empty bins.
        bin_accuracy: Fraction of correct predictions in each bin, (b,); NaN in empty bins.
        bin_counts: Number of predictions in each bin, (b,).
    """

    confusion: Int[np.ndarray, "c c"]
    accuracy: float
    precision: Float[np.ndarray, " c"]
    recall: Float[np.ndarray, " c"]
    f1: Float[np.ndarray, " c"]
    calibration_error: float
    bin_confidence: Float[np.ndarray, " b"]
    bin_accuracy: Float[np.ndarray, " b"]
    bin_counts: Int[np.ndarray, " b"]


def class_scores(
    probabilities: Float[np.ndarray, "n c"], truth: Int[np.ndarray, " n"], bins: int = 10
) -> ClassScores:
    """Return scores of predicted probabilities, binned for the calibration.

    Raises:
        ConfigError: There are no predictions, or a class is out of range.
    """
    count, classes = probabilities.shape
    if count == 0 or truth.min() < 0 or truth.max() >= classes:
        raise ConfigError(f"{count} answers among {classes} classes do not fit the true classes.")
    predicted = probabilities.argmax(axis=1)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    np.add.at(confusion, (truth, predicted), 1)
    hits = np.diag(confusion).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision, recall = hits / confusion.sum(axis=0), hits / confusion.sum(axis=1)
        f1 = 2.0 * hits / (confusion.sum(axis=0) + confusion.sum(axis=1))
        confidence = probabilities.max(axis=1)
        index = np.minimum((confidence * bins).astype(int), bins - 1)
        bin_counts = np.bincount(index, minlength=bins)
        bin_confidence = np.bincount(index, confidence, minlength=bins) / bin_counts
        bin_accuracy = np.bincount(index, predicted == truth, minlength=bins) / bin_counts
    error = np.nansum(bin_counts * np.abs(bin_confidence - bin_accuracy)) / count
    accuracy, in_bins = float(hits.sum() / count), (bin_confidence, bin_accuracy, bin_counts)
    return ClassScores(confusion, accuracy, precision, recall, f1, float(error), *in_bins)
