"""A full disk: one message, and no file that is half written."""

import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from tactorch.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
main(sys.argv[2:])
"""
TINY = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null", "press=top")
INVERT = ("recording={recording}", "plots=false", "method=map", "optimizer.max_iterations=1")
DATASET = (
    "dataset.count=2", "dataset.reconstruct=false", "dataset.mesh.relative_edge_length=0.3",
    "dataset.mesh.fine_relative=null", "workers=1", "card=false", "out=run/data",
)  # fmt: skip


@pytest.mark.parametrize(
    ("command", "settings", "limit"),
    [
        ("simulate", TINY, 9000),
        ("invert", INVERT, 6000),
        pytest.param("generate", DATASET, 9000, marks=pytest.mark.slow),
        ("simulate", TINY, 1000),  # not even the settings of the run
    ],
)
def test_a_full_disk_gets_one_line(
    command: str, settings: tuple[str, ...], limit: int, recording: Path, tmp_path: Path
) -> None:
    log = tmp_path / "run" / f"{command}.log"
    log.parent.mkdir()
    log.write_bytes(b"x" * (limit - 100))  # the log is full, too
    words = [word.format(recording=recording) for word in settings]
    done = subprocess.run(
        [sys.executable, "-B", "-c", CODE, str(limit), command, *words, "run_dir=run"],
        capture_output=True, text=True, timeout=120, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2, done.stdout + done.stderr
    lines = [line for line in done.stderr.splitlines() if "error" in line.lower()]
    assert len(lines) == 1, done.stderr
    assert "File too large" in lines[0]
    assert "Traceback" not in done.stderr + done.stdout
    assert "Arguments:" not in done.stderr
    left = {path.name for path in tmp_path.rglob("*") if path.suffix in (".h5", ".npz", ".vtu")}
    assert left <= {"case.h5", "checkpoint.npz"}
    assert not list(tmp_path.rglob("*.part*"))
