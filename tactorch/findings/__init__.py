"""Findings: lumps of a map with depth, confidence and text.

- `find_lumps`, `find_lump`: regions that stand out of a map, the most conspicuous first.
- `find`: lumps under the presses of a recording, from shapes or else from its map.
- `build_finding`: lumps of a map with depths and confidences, as numbers and text.
- `build_shape_finding`: the same of shapes that were fitted to the presses.
- `tactorch.findings.text`: sentences and facts that the command line, report and live runs show.
- `tactorch.findings.recognition`: probability of each shape that a recognizer knows; imported
  separately, because it loads Lightning.
"""

from tactorch.findings.finding import Confidence, Depth, Finding, Lump, Status, build_finding
from tactorch.findings.lumps import find_lump, find_lumps
from tactorch.findings.search import SHAPES, find
from tactorch.findings.shapes import build_shape_finding

__all__ = [
    "SHAPES",
    "Confidence",
    "Depth",
    "Finding",
    "Lump",
    "Status",
    "build_finding",
    "build_shape_finding",
    "find",
    "find_lump",
    "find_lumps",
]
