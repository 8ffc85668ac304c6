"""Runs fTetWild in a separate process: `python _tetwild_worker.py INPUT.npz OUTPUT.npz`.

fTetWild writes a file into the working folder and may abort the process on invalid geometry.
"""

import sys

import numpy as np


def main(source: str, target: str) -> None:
    """Read vertices, triangles and settings, write points and tets."""
    from pytetwild.pytetwild import tetrahedralize

    with np.load(source) as inputs:
        points, tets = tetrahedralize(
            inputs["vertices"],
            inputs["triangles"],
            edge_length_abs=float(inputs["edge_length_mm"]),
            epsilon=float(inputs["epsilon"]),
            coarsen=bool(inputs["coarsen"]),
            quiet=True,
            vtk_ordering=True,
        )
    np.savez(target, points=points, tets=tets)


if __name__ == "__main__":
    main(*sys.argv[1:])
