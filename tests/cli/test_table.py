"""`tactorch import format=table` and the inversion of what it writes."""

from pathlib import Path
from typing import Any

import numpy as np

from tactorch.mesh import write_mesh
from tactorch.recording import Recording


def test_a_table_is_imported_and_inverted(tactorch: Any, recording_file: Path) -> None:
    recording = Recording.load(recording_file)
    write_mesh("body.vtu", recording.mesh)
    nodes = recording.mesh.surface.nodes()
    lines = ["press,node,ux_um,uy_um,uz_um,fx_mN,fy_mN,fz_mN,spring_x,spring_y,spring_z"]
    for press in recording.presses:
        for node in nodes:
            numbers = [*1e3 * press.displacement[node], *1e3 * press.forces[node]]
            cells = ["" if np.isnan(n) else repr(float(n)) for n in numbers]
            springs = map(str, press.springs[node])
            lines.append(",".join([f'"{press.name}"', str(node), *cells, *springs]))
    Path("presses.csv").write_text("\n".join(lines))
    done = tactorch(
        "import", "format=table", "path=presses.csv", "format.mesh=body.vtu", "out=presses.h5",
        "format.noise_mm=0.001", "format.poisson=0.49",
    )  # fmt: skip
    assert done.status == 0, done.err
    made = Recording.load("presses.h5")
    np.testing.assert_allclose(
        made.presses[1].displacement, recording.presses[1].displacement, atol=1e-12
    )
    quick = ("plots=false", "method=map", "optimizer.max_iterations=1")
    assert tactorch("invert", "recording=presses.h5", *quick).status == 0


def test_a_wrong_table_gets_one_message(tactorch: Any, recording_file: Path) -> None:
    write_mesh("body.vtu", Recording.load(recording_file).mesh)
    Path("presses.csv").write_text("node,ux,fx\n500,0.1,0.1\n")
    done = tactorch(
        "import", "format=table", "path=presses.csv", "format.mesh=body.vtu", "out=presses.h5"
    )
    assert done.status == 2
    assert "'presses.csv' line 2 names node 500" in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not Path("presses.h5").exists()
