"""Tables and figures of the paper (Sections III-D, IV and V), reproduced.

Each exhibit (a table or figure) belongs to a study, a set of cases. A case is one simulation with
its inversions. Cases run in parallel, and each result is stored and reused.

- `reproduce`: writes exhibits from stored and new cases.
- `EXHIBITS`: names of the exhibits.

The numbers of the paper are in `paper.yaml`.
"""

from tactorch.reproduce.exhibits import EXHIBITS, reproduce

__all__ = ["EXHIBITS", "reproduce"]
