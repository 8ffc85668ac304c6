"""Studies and their exhibits."""

from types import ModuleType

from tactorch.reproduce import credibility, depths, design, models, recognition, sampling, sizes

#: Modules with `cases`, `run_case` and `EXHIBITS` (functions that write an exhibit), by name.
STUDIES: dict[str, ModuleType] = {
    "credibility": credibility,
    "models": models,
    "design": design,
    "sizes": sizes,
    "depths": depths,
    "recognition": recognition,
    "sampling": sampling,
}
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

#: Study of each exhibit, in the order of the paper.
EXHIBITS: dict[str, str] = {
    exhibit: next(name for name, study in STUDIES.items() if exhibit in study.EXHIBITS)
    for exhibit in TITLES
}
