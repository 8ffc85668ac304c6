"""Sweeps: names of the folders of their jobs, the table and the picture of all of them."""

import csv
import re
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli.sweep import Job, make_table, register_names

QUICK = ("optimizer.max_iterations=1", "method=map", "plots=false")


def test_a_sweep_ends_with_a_table_and_a_picture_of_all_runs(
    tactorch: Any, recording_file: Path
) -> None:
    given = (f"recording={recording_file}", *QUICK, "run_dir=sweep")
    done = tactorch("invert", "-m", *given, "noise.relative=0.001,0.01,-1")
    assert done.status == 2  # of the last job
    names = ("noise.relative-0.001", "noise.relative-0.01", "noise.relative-1")
    assert {path.name for path in Path("sweep").iterdir() if path.is_dir()} == set(names)
    table = done.out[done.out.rindex("noise.relative  result") :].splitlines()
    for row, noise in zip(table[1:3], ("0.001", "0.01"), strict=True):
        assert row.startswith(noise)
        assert re.search(r" (\d+ lumps?|nothing found|cannot tell) ", row)
    assert table[3].split()[:2] == ["-1", "failed"]
    with Path("sweep/runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["noise.relative"] for row in rows] == ["0.001", "0.01", "-1"]
    assert float(rows[0]["chi2"]) > float(rows[1]["chi2"]) > 0.0
    assert rows[0]["iterations"] == "1"
    assert rows[2]["chi2"] == "-"
    assert Path("sweep/runs.png").read_bytes()[:4] == b"\x89PNG"

    report = tactorch("report", "sweep", "uncertainty=false")
    assert report.status == 0, report.err
    page = Path("sweep/report.html").read_text()
    assert "2 runs compared" in page
    assert "noise.relative-0.001" in page


def test_one_job_has_no_table(tactorch: Any, recording_file: Path) -> None:
    done = tactorch("invert", f"recording={recording_file}", *QUICK, "run_dir=run")
    assert done.status == 0, done.err
    assert not Path("run/runs.csv").exists()


def test_a_folder_without_runs_is_refused(tactorch: Any) -> None:
    Path("empty").mkdir()
    done = tactorch("report", "empty")
    assert done.status == 2
    assert "empty" in done.err
    assert "finished `tactorch invert`" in done.err


def resolved(differing: str, number: int = 3) -> str:
    from omegaconf import OmegaConf

    config = OmegaConf.create({"x": "${tactorch_job:${n},${text}}", "n": number, "text": differing})
    return str(config.x)


def test_folders_are_named_by_what_differs_in_plain_characters() -> None:
    register_names()
    assert resolved("a.b=1,c=x") == "a.b-1_c-x"
    assert resolved("path=runs/a b.h5") == "path-runs-a-b.h5"
    assert resolved("") == "3"
    assert resolved("a.b=1,c=x", number=4) == "a.b-1_c-x-4"  # the name of another job
    assert len(resolved("k=" + "y" * 300)) < 110


def test_jobs_of_other_commands_have_their_settings(tmp_path: Path) -> None:
    jobs = [Job(tmp_path, {"seed": "1"}, False), Job(tmp_path, {"seed": "2"}, True)]
    table = make_table(jobs)
    assert table.header == ["seed", "result"]
    assert table.rows == [["1", "done"], ["2", "failed"]]
    (tmp_path / "summary.json").write_text("no json")
    assert make_table(jobs).rows[0] == ["1", "done"]


def test_findings_are_counted(tmp_path: Path) -> None:
    job = Job(tmp_path, {"seed": "1"}, False)
    for text, word in (
        ('{"finding": {"status": "found", "lumps": [{}, {}]}, "chi2": 1.234}', "2 lumps"),
        ('{"finding": {"status": "found", "lumps": [{}]}, "chi2": 1.234}', "1 lump"),
        ('{"finding": {"status": "nothing found", "lumps": []}, "chi2": 1.234}', "nothing found"),
    ):
        (tmp_path / "summary.json").write_text(text)
        assert make_table([job]).rows == [["1", word, "1.23"]]


@pytest.mark.parametrize("common", [True, False])
def test_a_comparison_has_a_row_for_each_run(common: bool) -> None:
    import numpy as np

    from tactorch.errors import ConfigError
    from tactorch.inverse import Reconstruction
    from tactorch.mesh import box_mesh
    from tactorch.viz import comparison_figure

    mesh = box_mesh(10.0, 2)
    moved = np.zeros((1, mesh.n_points, 3))
    runs = {
        str(value): Reconstruction(mesh, np.full(mesh.n_tets, value), moved, [], "x", 0.0)
        for value in (0.1, 0.4)
    }
    figure = comparison_figure(runs, common=common)
    limits = [axes.images[0].get_clim()[1] for axes in figure.axes if axes.images]
    assert len(limits) == 6
    assert (limits[0] == limits[-1]) == common
    with pytest.raises(ConfigError, match="pass at least one"):
        comparison_figure({})
