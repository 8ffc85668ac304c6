"""Wavefront .obj surfaces as programs write them.

meshio refuses files whose texture or normal lists are not as long as the vertex list, which is most
files that have any.
"""

from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


def read_obj(path: Path) -> tuple[Float[np.ndarray, "n 3"], list[tuple[str, NDArray]]]:
    """Read vertices and faces; colours, textures, normals and groups are passed over.

    Args:
        path: The file.

    Returns:
        Vertices, and runs of faces of one kind in the order of the file: "triangle", "quad" or
        "polygon", with indices from 0.

    Raises:
        ValueError: A line cannot be understood; the message gives its number.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    with path.open(encoding="utf-8", errors="strict") as lines:
        for number, line in enumerate(lines, start=1):
            key, *fields = line.split("#")[0].split() or [""]
            try:
                if key == "v":
                    vertices.append(_position(fields))
                elif key == "f":
                    faces.append([_index(field, len(vertices)) for field in fields])
            except ValueError as error:
                raise ValueError(f"line {number}: {error}") from error
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), _runs(faces)


def _position(fields: list[str]) -> list[float]:
    if len(fields) < 3:
        raise ValueError(f"a vertex needs three coordinates, not {len(fields)}")
    return [float(field) for field in fields[:3]]


def _index(field: str, count: int) -> int:
    """Read `vertex/texture/normal`; vertices count from 1, or back from the latest from -1."""
    index = int(field.split("/")[0])
    if index == 0 or index < -count:
        raise ValueError(f"there is no vertex {index}")
    return index - 1 if index > 0 else count + index


def _runs(faces: list[list[int]]) -> list[tuple[str, NDArray]]:
    kinds = {3: "triangle", 4: "quad"}
    return [
        (kinds.get(size, "polygon"), np.array(list(run))) for size, run in groupby(faces, key=len)
    ]
