"""A volume of labels: one integer for each voxel, and the place of the voxels. Lengths in mm."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import FileError
from tactorch.mesh.values import Points

#: Array of a file, its affine matrix, their unit, and the names of labels.
Content = tuple[np.ndarray, Float[np.ndarray, "4 4"], str, dict[int, str]]
_MIN_VOLUME = 1e-9  # of a voxel, over its longest edge cubed
_SHOWN = 20  # labels that a message lists


@dataclass(frozen=True, eq=False)
class LabelVolume:
    """Label of each voxel; 0 is the background.

    Attributes:
        labels: Labels, int32.
        affine: Matrix from voxel indices (i, j, k, 1) to the position of the voxel's centre, mm.
        names: Names of labels, where the file states them.
        source: Name of the file in messages.
        unit: Unit of the lengths in the file, in messages.

    Raises:
        FileError: The affine matrix is not finite or not affine, or voxels have no volume.
    """

    labels: Int[np.ndarray, "i j k"]
    affine: Float[np.ndarray, "4 4"]
    names: Mapping[int, str] = field(default_factory=dict)
    source: str = "volume"
    unit: str = "mm"

    def __post_init__(self) -> None:
        if not np.isfinite(self.affine).all():
            raise FileError(
                f"'{self.source}': the affine matrix has entries that are no finite numbers; write "
                "the file again with the spacing and orientation of the voxels."
            )
        if not np.array_equal(self.affine[3], [0.0, 0.0, 0.0, 1.0]):
            raise FileError(
                f"'{self.source}': the last row of the affine matrix is {self.affine[3].tolist()}, "
                "not 0, 0, 0, 1; give the matrix that maps the column (i, j, k, 1) to a position."
            )
        sizes = self.voxel_mm
        if not self.voxel_mm3 > _MIN_VOLUME * sizes.max() ** 3:
            shown = " x ".join(f"{size:.3g}" for size in sizes)
            raise FileError(
                f"'{self.source}': voxels of {shown} mm have no volume; write the file again with "
                "the spacing of the voxels."
            )

    @cached_property
    def voxel_mm(self) -> Float[np.ndarray, "3"]:
        """Edge lengths of a voxel, mm."""
        sizes: np.ndarray = np.linalg.norm(self.affine[:3, :3], axis=0)
        return sizes

    @cached_property
    def voxel_mm3(self) -> float:
        """Volume of a voxel, mm^3."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    @cached_property
    def numbers(self) -> Int[np.ndarray, " k"]:
        """Labels that occur, without the background, ascending."""
        numbers: np.ndarray = np.unique(self.labels)
        return numbers[numbers != 0].astype(np.int64)

    def name(self, number: int) -> str:
        """Return a label as text, with its name where it has one."""
        return f"{number} ({self.names[number]})" if number in self.names else str(number)

    def select(self, numbers: Iterable[int] | None, names: Mapping[int, str]) -> "LabelVolume":
        """Return the volume with only some labels, by default all; others become background.

        Args:
            numbers: Labels to keep; None for all.
            names: Further names of labels.

        Raises:
            FileError: There is no label, or not one of these.
        """
        volume = replace(self, names={**self.names, **names})
        if not len(self.numbers):
            raise FileError(
                f"'{self.source}' is empty: all voxels are 0, the background. Is it the image "
                "instead of its segmentation?"
            )
        if numbers is None:
            return volume
        kept = sorted(set(numbers))
        absent = [number for number in kept if number not in self.numbers]
        if absent or not kept:
            shown = ", ".join(map(self.name, self.numbers[:_SHOWN].tolist()))
            more = f" and {len(self.numbers) - _SHOWN} more" if len(self.numbers) > _SHOWN else ""
            what = f"has no label {absent[0]}" if kept else "needs one label or more"
            raise FileError(f"'{self.source}' {what}; its labels are {shown}{more}.")
        return replace(volume, labels=np.where(np.isin(self.labels, kept), self.labels, 0))

    def indices(self, points: Points) -> Int[np.ndarray, "n 3"]:
        """Return the voxel that contains each point (mm), or the nearest one of the volume."""
        voxels = np.rint(self.coordinates(points))
        return np.clip(voxels, 0, np.array(self.labels.shape) - 1).astype(np.int64)

    def coordinates(self, points: Points) -> Float[np.ndarray, "n 3"]:
        """Return the voxel indices of points (mm), which are not whole; see `positions`."""
        inverse = np.linalg.inv(self.affine)
        return points @ inverse[:3, :3].T + inverse[:3, 3]

    def positions(self, indices: Float[np.ndarray, "n 3"]) -> Points:
        """Return the positions of voxel indices, which need not be whole, mm."""
        return indices @ self.affine[:3, :3].T + self.affine[:3, 3]
