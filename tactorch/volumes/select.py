"""The voxels of a labelled volume that are a body: labels, pieces, holes and open sides."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from tactorch.config import Options, option
from tactorch.errors import FileError
from tactorch.mesh.io import PLAUSIBLE_MM
from tactorch.volumes.body import Body
from tactorch.volumes.read import MM_PER_UNIT, LengthUnit, read_volume
from tactorch.volumes.surface import extent
from tactorch.volumes.volume import LabelVolume

_log = logging.getLogger(__name__)
_SHOWN = 5  # pieces of a body that a message lists


@dataclass(frozen=True, kw_only=True)
class BodySettings(Options):
    """Voxels of a labelled volume that are the body."""

    labels: dict[int, str] | tuple[int, ...] | None = option(
        None, "Labels that make up the body, as a list or with names; null: all but 0"
    )
    keep_largest: bool = option(False, "Leave out all pieces of the body but the largest")
    fill_holes: bool = option(
        True, "Give voxels of other labels or 0 that the body encloses its nearest label"
    )
    close_at_edge: bool = option(
        True, "Close a body that touches the edge of the volume by a flat face; false: refuse it"
    )
    unit: LengthUnit | None = option(
        None, "Unit of the lengths in the file; null: the one it states, or else mm"
    )
    spacing_mm: tuple[float, float, float] | None = option(
        None, "Edge lengths of the voxels, for .npy and .npz that do not state them", unit="mm",
        gt=0,
    )  # fmt: skip


def read_body(
    path: str | Path, settings: BodySettings | None = None, *, check_units: bool = True
) -> Body:
    """Read the body of a labelled volume.

    Args:
        path: The file, see `tactorch.volumes.read_volume`.
        settings: Labels of the body, and what is done with pieces, holes and open sides.
        check_units: Whether a size that suggests a wrong unit is refused.

    Raises:
        ConfigError: See `read_volume`.
        FileError: See `read_volume`; or the volume is empty, has not one of the labels, several
            pieces or an implausible size, or the body touches its edge.
    """
    settings = settings or BodySettings()
    volume = read_volume(path, unit=settings.unit, spacing_mm=settings.spacing_mm)
    labels = settings.labels
    volume = volume.select(labels, labels if isinstance(labels, dict) else {})
    volume = _one_piece(volume, keep_largest=settings.keep_largest)
    volume = _cropped(volume, close_at_edge=settings.close_at_edge)
    if settings.fill_holes:
        volume = _without_holes(volume)
    body = Body(volume, settings.keep_largest)
    if check_units:
        _check_size(body)
    return body


def _one_piece(volume: LabelVolume, *, keep_largest: bool) -> LabelVolume:
    """Refuse voxels that do not share faces, or leave out all but the largest piece."""
    pieces, count = ndimage.label(volume.labels != 0)
    if count == 1:
        return volume
    sizes = np.bincount(pieces.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")
    shown = ", ".join(
        f"{sizes[i]} voxels ({sizes[i] * volume.voxel_mm3:.3g} mm^3)" for i in order[:_SHOWN]
    )
    more = ", ..." if count > _SHOWN else ""
    if not keep_largest:
        raise FileError(
            f"'{volume.source}' has a body of {count} pieces that share no face: {shown}{more}. "
            "Give keep_largest=true to keep the largest, or choose other labels."
        )
    left = 1.0 - sizes[order[0]] / sizes.sum()
    _log.warning(
        "'%s': %d of %d pieces are left out, %.2g %% of the voxels.",
        volume.source, count - 1, count, 100.0 * left,
    )  # fmt: skip
    return replace(volume, labels=np.where(pieces == 1 + order[0], volume.labels, 0))


def _cropped(volume: LabelVolume, *, close_at_edge: bool) -> LabelVolume:
    """Return the voxels around the body; name the sides at which it touches the edge."""
    places = extent(volume.labels != 0)
    sides = [
        f"{side} of axis {axis}"
        for axis, ((first, last), size) in enumerate(zip(places, volume.labels.shape, strict=True))
        for side, touches in (("start", first == 0), ("end", last == size - 1))
        if touches
    ]
    if sides and not close_at_edge:
        raise FileError(
            f"'{volume.source}': the body touches the edge of the volume (voxels at the "
            f"{', '.join(sides)}), where it may be cut off. Give close_at_edge=true to close it "
            "there."
        )
    if sides:
        _log.warning(
            "'%s': the body touches the edge of the volume (voxels at the %s), where it is closed "
            "by a flat face.", volume.source, ", ".join(sides),
        )  # fmt: skip
    box = tuple(slice(max(first - 1, 0), last + 2) for first, last in places)
    affine = volume.affine.copy()
    affine[:3, 3] = volume.positions(np.array([[s.start for s in box]], dtype=float))[0]
    return replace(volume, labels=volume.labels[box], affine=affine)


def _without_holes(volume: LabelVolume) -> LabelVolume:
    """Give background that the body encloses the label of the nearest voxel."""
    mask = volume.labels != 0
    holes = ndimage.binary_fill_holes(mask) & ~mask
    if not holes.any():
        return volume
    _log.info(
        "'%s': %d voxels of other labels or 0 inside the body get its nearest label.",
        volume.source,
        holes.sum(),
    )
    nearest = Body(volume).nearest
    return replace(volume, labels=np.where(holes, nearest, volume.labels))


def _check_size(body: Body) -> None:
    """Refuse a size that suggests a wrong unit."""
    low, high = PLAUSIBLE_MM
    size, source = body.diagonal_mm, body.volume.source
    if low <= size <= high:
        return
    unit = body.volume.unit
    number = size / MM_PER_UNIT[unit]
    likely = [u for u, mm in MM_PER_UNIT.items() if low <= number * mm <= high]
    hint = f"Is it in {' or '.join(likely)}? Give unit." if likely else "Check the spacing."
    raise FileError(
        f"'{source}': the body is {size:.3g} mm across when read in {unit}, from voxels of "
        f"{body.volume.voxel_mm.max():.3g} mm. {hint} check_units=false accepts it."
    )
