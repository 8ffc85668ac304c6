"""One sample: an object, its presses, and optionally its reconstruction."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.generation.recipe import Recipe
from tactorch.inverse import invert_map
from tactorch.inverse.fit.linear_image import linear_map
from tactorch.metrics import scores
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.simulation import simulate
from tactorch.touch import Touch, simulate_touch


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample of a dataset.

    Attributes:
        index: Number in the dataset.
        object: Number of the object that was pressed.
        label: Class of the object, for a recognizer.
        facts: Random properties of the object, as plain values.
        recording: Presses, with the truth per element.
        reconstruction: Moduli reconstructed from the presses, (m,), MPa; None where none was made.
        figures: Iterations, chi2 and scores of the reconstruction against the truth.
        touch: Images, markers and forces of the sensor in each press; None without a sensor.
    """

    index: int
    object: int
    label: str
    facts: dict[str, Any]
    recording: Recording
    reconstruction: Float[np.ndarray, " m"] | None = None
    figures: dict[str, float] | None = None
    touch: Touch | None = None

    @property
    def truth(self) -> Float[np.ndarray, " m"]:
        """True moduli, MPa."""
        assert self.recording.truth is not None
        return self.recording.truth

    @property
    def largest_mm(self) -> float:
        """Largest observed component of a displacement, mm."""
        observed = [press.displacement[press.observed] for press in self.recording.presses]
        return float(np.abs(np.concatenate(observed)).max())


def make_sample(recipe: Recipe, index: int) -> Sample:
    """Make a sample; the result depends on recipe and index alone.

    Raises:
        TactorchError: The object cannot be drawn, meshed, pressed or reconstructed.
    """
    drawn = recipe.drawn(index)
    rng = np.random.default_rng([recipe.seed, 1, index])
    snr_db = None if recipe.snr_db is None else float(rng.uniform(*recipe.snr_db))
    touch = None
    if recipe.has_touch:
        recording, touch = simulate_touch(
            drawn.phantom,
            *recipe.meshes(drawn.phantom),
            material=recipe.material_of(index),
            options=recipe.touch,
            rng=rng,
            samples=recipe.samples,
            snr_db=snr_db,
        )
    else:
        recording = _pressed(recipe, drawn.phantom, recipe.material_of(index), snr_db, rng)
    mesh = recording.mesh
    youngs, figures = None, None
    if recipe.inversion is not None:
        assert recording.truth is not None
        figures = {}
        if isinstance(recipe.inversion, str):
            youngs = linear_map(recording)
        else:
            result = invert_map(recording, recipe.inversion, show_progress=False)
            youngs = result.youngs
            figures["iterations"] = float(len(result.history) - 1)
            figures["chi2"] = float(result.history[-1]["chi2"])
        figures |= {k: float(v) for k, v in scores(mesh, youngs, recording.truth).items()}
    number = index // recipe.views
    return Sample(index, number, drawn.label, drawn.parameters, recording, youngs, figures, touch)


def _pressed(
    recipe: Recipe,
    phantom: Phantom,
    material: MaterialSpec,
    snr_db: float | None,
    rng: np.random.Generator,
) -> Recording:
    """Return the recording of presses by pressures."""
    mesh, fine = recipe.meshes(phantom)
    median = float(np.median(phantom.on_mesh(mesh, samples=recipe.samples)))
    return simulate(
        phantom,
        recipe.presses.draw(rng, phantom.body.bounds(), median),
        material=material,
        mesh=mesh,
        fine_mesh=fine,
        samples=recipe.samples,
        element=recipe.element,
        snr_db=snr_db,
        seed=int(rng.integers(2**31)),
    )
