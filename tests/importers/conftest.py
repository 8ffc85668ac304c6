"""A simulated recording, and its presses as rows of tables."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.mesh import box_mesh, write_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="session")
def simulated() -> Recording:
    """Two presses on a cube of 10 mm from the top, whose bottom is fixed."""
    return simulate(
        make_phantom("cube_sphere", radius=0.3),
        PressPlan(("z+",), (0.01, 0.02), support="fixed"),
        mesh=box_mesh(10.0, 2, tets_per_cell=5),
        samples=1,
    )


@pytest.fixture
def body(simulated: Recording, tmp_path: Path) -> Path:
    """The mesh as a file."""
    write_mesh(tmp_path / "body.vtu", simulated.mesh)
    return tmp_path / "body.vtu"


@pytest.fixture
def rows(simulated: Recording) -> dict[str, np.ndarray]:
    """Columns of the surface nodes of both presses."""
    nodes, points = simulated.mesh.surface.nodes(), simulated.mesh.points
    columns: dict[str, list[np.ndarray]] = {}
    for number, press in enumerate(simulated.presses, start=1):
        values = {"press": np.full(len(nodes), number), "node": nodes}
        values |= {f"{axis}_mm": points[nodes, i] for i, axis in enumerate("xyz")}
        values |= {f"u{axis}_mm": press.displacement[nodes, i] for i, axis in enumerate("xyz")}
        values |= {f"f{axis}_n": press.forces[nodes, i] for i, axis in enumerate("xyz")}
        for name, column in values.items():
            columns.setdefault(name, []).append(column)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def write_rows(path: Path, columns: dict[str, np.ndarray], delimiter: str = ",") -> Path:
    """Write columns as text; NaN are empty cells."""
    lines = [delimiter.join(columns)]
    for cells in zip(*columns.values(), strict=True):
        texts = ["" if isinstance(c, float) and np.isnan(c) else f"{c}" for c in cells]
        lines.append(delimiter.join(texts))
    path.write_text("\n".join(lines) + "\n")
    return path
