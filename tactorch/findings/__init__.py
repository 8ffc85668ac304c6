"""What a map of Young's modulus is good for: where a lump is, how deep, how sure, which shape.

- `find_lumps`: the parts of a map that stand out, the most conspicuous first; `find_lump`: that
  one alone.
- `lay_under`: depth of a lump below the pressed surface.
- `finding_of`: lumps, depths and, with a posterior, how sure; as numbers and as text.
- `tactorch.findings.recognition`: which of the shapes that a recognizer knows a map shows;
  imported by itself, because it loads Lightning.
"""

from tactorch.findings.confidence import Confidence, confidence_of
from tactorch.findings.depth import Depth, lay_under
from tactorch.findings.finding import Finding, Lump, finding_of
from tactorch.findings.lumps import find_lump, find_lumps

__all__ = [
    "Confidence",
    "Depth",
    "Finding",
    "Lump",
    "confidence_of",
    "find_lump",
    "find_lumps",
    "finding_of",
    "lay_under",
]
