"""The finding of a recording: shapes that are fitted to its presses, or regions of its map."""

from collections.abc import Callable
from dataclasses import replace

from tactorch.errors import CancelledError, ConfigError
from tactorch.findings.finding import Finding, build_finding
from tactorch.findings.shapes import build_shape_finding
from tactorch.inverse import (
    Reconstruction,
    Settings,
    ShapeReconstruction,
    find_shapes,
    is_palpation,
    settings_from,
)
from tactorch.inverse.shapes import KeptRims, ShapeState
from tactorch.recording import Recording
from tactorch.uncertainty import GaussianPosterior, compute_posterior
from tactorch.uncertainty.select import UNCOMPUTABLE

#: File of the fitted shapes in the folder of a run.
SHAPES = "shapes.json"
#: Elements up to which `find` fits shapes, whose quadratic elements have eight times the unknowns.
MAX_ELEMENTS = 20_000


def find(
    recording: Recording,
    reconstruction: Reconstruction | None = None,
    settings: Settings | None = None,
    *,
    shapes: bool = True,
    max_lumps: int = 5,
    uncertainty: bool = True,
    start: ShapeReconstruction | ShapeState | None = None,
    stop: Callable[[], bool] = lambda: False,
    kept: KeptRims | None = None,
) -> Finding:
    """Find the lumps under the presses of a recording.

    Lumps are shapes that are fitted to the presses, see `find_shapes`. Without `shapes`, where the
    fit fails, or on meshes of more than 20,000 elements but for a palpation, they are regions of
    the map; a note of the finding states the reason.

    Args:
        recording: Presses; the truth is not read.
        reconstruction: Map of these presses.
        settings: Settings of the inversion; by default those of the reconstruction.
        shapes: Whether shapes are fitted.
        max_lumps: Largest number of lumps.
        uncertainty: Whether regions of the map get a confidence, for which the presses are solved
            again.
        start: Shapes of other presses on the object, or what a stopped search had `reached`, from
            which the search starts.
        stop: Called before each fit of shapes; where it is true the search ends.
        kept: See `find_shapes`.

    Returns:
        The finding; its `shapes` are those that were fitted.

    Raises:
        CancelledError: see `stop`.
        ConfigError: `max_lumps` is below 1, there is no map although `shapes` is false, or as of
            `find_shapes` where there is no map.
        ConvergenceError: as of `find_shapes` where there is no map.
    """
    if max_lumps < 1:
        raise ConfigError(f"max_lumps={max_lumps}: give at least 1.")
    if reconstruction is None and not shapes:
        raise ConfigError("shapes=False: give the reconstruction, whose regions are the lumps.")
    notes: tuple[str, ...] = ()
    if shapes:
        try:
            chosen = _settings(reconstruction, settings)
            _check_size(recording)
            fitted = find_shapes(
                recording, chosen, max_shapes=max_lumps, start=start, stop=stop, kept=kept
            )
            return build_shape_finding(recording, fitted)
        except CancelledError:
            raise
        except UNCOMPUTABLE as error:
            if reconstruction is None:
                raise
            notes = (f"The finding is that of the map: no shapes can be fitted ({_text(error)}).",)
    assert reconstruction is not None
    finding = _find_regions(recording, reconstruction, settings, max_lumps, uncertainty)
    return replace(finding, notes=(*notes, *finding.notes))


def _check_size(recording: Recording) -> None:
    count = recording.mesh.n_tets
    # All places of a palpation share one factorisation.
    if count > MAX_ELEMENTS and not is_palpation(recording):
        raise ConfigError(
            f"the mesh has {count} elements, more than {MAX_ELEMENTS}, and the fits would take "
            "much time and memory; call tactorch.find_shapes to fit them all the same"
        )


def _find_regions(
    recording: Recording,
    reconstruction: Reconstruction,
    settings: Settings | None,
    max_lumps: int,
    uncertainty: bool,
) -> Finding:
    """Return the regions of a map, and why they have no confidence where it cannot be computed."""
    notes: tuple[str, ...] = ()
    posterior: GaussianPosterior | None = None
    if uncertainty and not reconstruction.warnings:
        try:
            chosen = _settings(reconstruction, settings)
            posterior = compute_posterior(recording, reconstruction, chosen)
        except UNCOMPUTABLE as error:
            notes = (f"The confidence cannot be computed ({_text(error)}).",)
    finding = build_finding(
        recording, reconstruction.youngs, posterior,
        max_lumps=max_lumps, reasons=reconstruction.warnings,
    )  # fmt: skip
    return replace(finding, notes=notes)


def _settings(reconstruction: Reconstruction | None, settings: Settings | None) -> Settings:
    if settings is not None:
        return settings
    return Settings() if reconstruction is None else settings_from(reconstruction.config)


def _text(error: BaseException) -> str:
    return str(error).rstrip(".") or "not enough memory"
