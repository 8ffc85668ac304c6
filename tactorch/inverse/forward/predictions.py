"""Predictions of the presses at a result, for its files, pictures and tables."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.inverse.data.observations import NoiseModel, Observation
from tactorch.inverse.forward.problem import Evaluation
from tactorch.recording import Press, Recording


class Predictions(NamedTuple):
    """Predictions of all presses, corrected for the errors of the model that were estimated."""

    displacements: Float[np.ndarray, "presses n 3"]  # mm, on the recording's mesh; or no presses
    data: Float[np.ndarray, " data"]  # mm, N and N mm, in the order of each press's `Observation`
    residuals: Float[np.ndarray, " data"]  # predicted less observed, in standard deviations

    @staticmethod
    def of(evaluation: Evaluation, recording: Recording) -> "Predictions":
        """Return the predictions of an evaluation, maybe on a refinement of the recording's mesh.

        The data of the evaluation may be shifted by estimated errors of the model; the predictions
        are of the data as they were recorded.
        """
        n = recording.mesh.n_points
        correction = observed_data(recording.presses) - evaluation.data.values
        return Predictions(
            np.array([u[:n] for u in evaluation.on_object]).reshape(-1, n, 3),
            np.concatenate(evaluation.predicted) + correction,
            np.concatenate(evaluation.deviations),
        )

    @staticmethod
    def of_nodes(
        displacements: Float[np.ndarray, "presses n 3"], recording: Recording, noise: NoiseModel
    ) -> "Predictions":
        """Return the predictions by displacements of nodes (mm), of which other data are unknown.

        Residuals are in the stated deviations of nodes, whose errors are not independent.
        """
        predicted, residuals = list[np.ndarray](), list[np.ndarray]()
        pairs = zip(recording.presses, noise.deviations(recording), displacements, strict=True)
        for press, deviation, moved in pairs:
            data = Observation.of(press, deviation)
            own = np.full(len(data.values), np.nan)
            own[data.nodal] = moved.ravel()[data.index]
            predicted.append(own)
            residuals.append((own - data.values) * data.scale)
        return Predictions(displacements, np.concatenate(predicted), np.concatenate(residuals))


def observed_data(presses: Sequence[Press]) -> Float[np.ndarray, " data"]:
    """Return the recorded data of all presses, in the order of `Predictions.data`."""
    return np.concatenate([Observation.of(press, 1.0).values for press in presses])
