"""The one result of an inversion: field, lumps with intervals, files, and the words for it."""

from tactorch.inverse.result.lump import Confidence, Depth, Lump
from tactorch.inverse.result.reconstruction import LEVEL, Reconstruction, Status
from tactorch.inverse.result.regions import find_lump, find_lumps

__all__ = [
    "LEVEL",
    "Confidence",
    "Depth",
    "Lump",
    "Reconstruction",
    "Status",
    "find_lump",
    "find_lumps",
]
