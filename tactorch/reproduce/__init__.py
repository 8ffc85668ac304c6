"""The paper's tables and figures, made anew (Sections III-D, IV, V and V-C).

Each exhibit (a table or a figure) belongs to a study: a set of cases, each a simulation and an
inversion or two, which are made side by side, stored one by one, and never twice.

- `make`: the exhibits that are asked for, from what is stored and what has yet to be made.
- `EXHIBITS`: their names.

The paper's numbers stand in `paper.yaml`.
"""

from tactorch.reproduce.make import make
from tactorch.reproduce.studies import EXHIBITS

__all__ = ["EXHIBITS", "make"]
