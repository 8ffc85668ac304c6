"""Which study makes which exhibit."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from tactorch.reproduce import credibility, depths, design, models, recognition, sampling, sizes
from tactorch.reproduce.cases import Case, Outcome

Exhibit = Callable[[Mapping[str, Outcome], Mapping[str, Any], Path], str]

STUDIES: dict[str, ModuleType] = {
    "credibility": credibility,
    "models": models,
    "design": design,
    "sizes": sizes,
    "depths": depths,
    "recognition": recognition,
    "sampling": sampling,
}
_EXHIBITS: dict[str, tuple[str, Exhibit]] = {
    exhibit: (name, write)
    for name, study in STUDIES.items()
    for exhibit, write in study.EXHIBITS.items()
}
#: In the paper's order.
EXHIBITS: Sequence[str] = (
    "table1",
    "table2",
    *(f"fig{i}" for i in (3, 4, 5, 7, 8, 9, 10, 11, 12)),
)
TITLES = {
    "table1": "Table I: time and similarity of ten models",
    "table2": "Table II: design factors and noise",
    "fig3": "Fig. 3: credibility by depth, pressure and stiffness",
    "fig4": "Fig. 4: objects of two materials",
    "fig5": "Fig. 5: heterogeneous objects",
    "fig7": "Fig. 7: maps by design factor",
    "fig8": "Fig. 8: similarity by depth",
    "fig9": "Fig. 9: wrong sizes of the object",
    "fig10": "Fig. 10: depth of a hard ball",
    "fig11": "Fig. 11: recognition of inclusions",
    "fig12": "Fig. 12: where to press next",
}


def study_of(exhibit: str) -> str:
    """Return the name of the study that an exhibit shows."""
    return _EXHIBITS[exhibit][0]


def writer_of(exhibit: str) -> Exhibit:
    """Return what writes an exhibit's files and says what they show."""
    return _EXHIBITS[exhibit][1]


def cases_of(study: str, options: Mapping[str, Any]) -> list[Case]:
    """Return all cases of a study."""
    found: list[Case] = STUDIES[study].cases(options)
    return found


def about(study: str) -> str:
    """Return what a study does, in the words of its module."""
    return (STUDIES[study].__doc__ or "").strip()
