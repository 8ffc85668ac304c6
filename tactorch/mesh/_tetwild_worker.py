"""Runs fTetWild in a process of its own: `python _tetwild_worker.py INPUT.npz OUTPUT.npz`.

fTetWild leaves a file in the working folder and can end the process on geometry it cannot handle;
neither may happen to the user's program.
"""

import sys

import numpy as np


def main(source: str, target: str) -> None:
    """Read vertices, triangles and settings, write points and tets."""
    from pytetwild.pytetwild import tetrahedralize

    with np.load(source) as given:
        points, tets = tetrahedralize(
            given["vertices"],
            given["triangles"],
            edge_length_abs=float(given["edge_length_mm"]),
            epsilon=float(given["epsilon"]),
            quiet=True,
        )
    np.savez(target, points=points, tets=tets)


if __name__ == "__main__":
    main(*sys.argv[1:])
