"""`tactorch generate` and `tactorch train`, on data that take a moment."""

import json
from pathlib import Path
from typing import Any

import pytest

TINY = (
    "dataset.count=6", "dataset.shard=3", "dataset.reconstruct=false", "dataset.samples=1",
    "dataset.mesh.relative_edge_length=0.3", "dataset.mesh.fine_relative=null",
    "dataset.presses.steps=[1]", "workers=1",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "shapes"


@pytest.mark.slow
def test_generate_writes_a_dataset_with_its_card(tactorch: Any, folder: Path) -> None:
    done = tactorch("generate", *TINY, f"out={folder}")
    assert done.status == 0, done.err
    assert {path.name for path in folder.iterdir() if path.is_file()} >= {
        "shard-00000.h5", "shard-00001.h5", "manifest.json", "recipe.json", "card.md", "card.png",
    }  # fmt: skip
    assert "6 of 6 samples, 0 failed" in done.out
    stamp = (folder / "shard-00000.h5").stat().st_mtime_ns
    again = tactorch("generate", *TINY, f"out={folder}")
    assert again.status == 0
    assert (folder / "shard-00000.h5").stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("dataset=cats",), ("cats", "recognition")),
        (("dataset.count=0",), ("dataset", "count=0", "at least 1")),
        (("dataset.count=six",), ("dataset.count='six'", "a whole number")),
        (("dataset.seed=9",), ("another recipe", "seed is 0 there and 9 here")),
        (("+dataset.family.sise=1",), ("dataset.family.sise", "'dataset.family.size'")),
        (("dataset.family.name=cats",), ("dataset.family=cats is unknown",)),
        (
            ("dataset.presses.faces=[[top]]",),
            (
                "dataset.presses.faces=[['top']]",
                "x-, x+",
            ),
        ),
        (("dataset.presses.p_max_mpa=0.02",), ("dataset.presses.p_max_mpa=0.02", "two numbers")),
        (("executor=dask",), ("needs scheduler",)),
        (("max_seconds=3", "dataset.reconstruct=true"), ("max_seconds",)),
    ],
)
def test_wrong_settings_of_generate(
    tactorch: Any, folder: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    if not (folder / "manifest.json").is_file():
        tactorch("generate", *TINY, f"out={folder}")
    done = tactorch("generate", *TINY, f"out={folder}", *arguments)
    assert done.status == 2
    assert len(done.err.splitlines()) == 1
    assert all(word in done.err for word in words), done.err


TOUCH = (
    "dataset=touch", "dataset.count=1", "dataset.family.width_mm=[10,12]",
    "dataset.family.count=[0,0]", "dataset.touch.presses=[1,1]", "dataset.touch.gel_edge_mm=2.6",
    "dataset.touch.image_width_px=40", "dataset.mesh.relative_edge_length=0.14",
    "dataset.mesh.fine_relative=0.18", "dataset.samples=1", "workers=1",
)  # fmt: skip


@pytest.mark.slow
def test_generate_writes_touches_with_their_pictures(tactorch: Any, tmp_path: Path) -> None:
    done = tactorch("generate", *TOUCH, f"out={tmp_path / 'touch'}")
    assert done.status == 0, done.err
    card = (tmp_path / "touch" / "card.md").read_text()
    assert "For each press of the sensor `gelsight_markers`" in card
    assert "![What the sensor sees](touch.png)" in card
    assert (tmp_path / "touch" / "touch.png").stat().st_size > 10_000
    other = tactorch("generate", *TOUCH, "dataset.touch.friction=none", f"out={tmp_path / 'touch'}")
    assert other.status == 2
    assert "touch.friction is 'stick' there and 'none' here" in other.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("dataset.touch.sensor=fingr",), ("fingr", "finger, gelsight_markers")),
        (("dataset.touch.presses=[0,1]",), ("dataset.touch.presses", "at least 1")),
        (("dataset.touch.depth=1",), ("dataset.touch.depth", "dataset.touch.depth_mm")),
        (("dataset.touch.friction=glue",), ("dataset.touch.friction='glue'", "stick")),
        (("dataset.family.name=cats",), ("dataset.family=cats is unknown", "bodies, file")),
        (("dataset.family={name: file}",), ("family.file is required",)),
        (("dataset.family={name: file, file: no.stl}",), ("no.stl",)),
        (("material=linear",), ("material=linear", "neo_hookean of the gel")),
    ],
)
def test_wrong_settings_of_touch(
    tactorch: Any, tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    done = tactorch("generate", "dataset=touch", f"out={tmp_path / 'x'}", *arguments)
    assert done.status == 2
    assert len(done.err.splitlines()) == 1, done.err
    assert all(word in done.err for word in words), done.err


@pytest.mark.slow
def test_train_learns_and_resumes(tactorch: Any, folder: Path, tmp_path: Path) -> None:
    """Two epochs and two more are four; the curve has them all."""
    if not (folder / "manifest.json").is_file():
        tactorch("generate", *TINY, f"out={folder}")
    run = tmp_path / "run"
    settings = (
        f"data.folder={folder}", "data.source=truth", "data.voxels=6",
        "data.shares=[0.5,0.25,0.25]", "model.hidden=4", "model.layers=2", f"run_dir={run}",
    )  # fmt: skip
    done = tactorch("train", *settings, "trainer.max_epochs=2")
    assert done.status == 0, done.err
    assert {path.name for path in run.iterdir()} >= {"best.ckpt", "last.ckpt", "curve.json"}
    done = tactorch("train", f"resume={run}", "trainer.max_epochs=4")
    assert done.status == 0, done.err
    assert [row["epoch"] for row in json.loads((run / "curve.json").read_text())] == [0, 1, 2, 3]
    whole = tactorch("train", *settings[:-1], f"run_dir={tmp_path / 'x'}", "trainer.max_epochs=4")
    assert whole.status == 0
    judged = tactorch("evaluate-model", f"run={run}", f"run_dir={tmp_path / 'judged'}")
    assert judged.status == 0, judged.err
    assert {path.name for path in (tmp_path / "judged").iterdir()} >= {
        "scores.json", "confusion.png", "calibration.png", "examples.png",
    }  # fmt: skip
    same = tactorch(
        "evaluate-model", f"run={run}", f"folder={folder}", f"run_dir={tmp_path / 'same'}"
    )
    assert same.status == 0, same.err
    assert json.loads((tmp_path / "same" / "scores.json").read_text())["samples"] == 6
    assert "test/accuracy" in json.loads((run / "scores.json").read_text())["summary"]
    other = tactorch("train", f"resume={run}", "model.hidden=8")
    assert other.status == 2
    assert "is of another model" in other.err
    (run / "last.ckpt").write_bytes(b"x" * 1000)
    broken = tactorch("train", f"resume={run}", "trainer.max_epochs=5")
    assert broken.status == 2
    assert "is damaged or no checkpoint" in broken.err
    for name, content in (
        ("data.json", "{"), ("data.json", "[]"), ("data.json", "{}"),
        (".hydra/config.yaml", "model: [\n"), (".hydra/config.yaml", "model: {name: recognizer}\n"),
        (".hydra/config.yaml", "\0\1"),
    ):  # fmt: skip
        before = (run / name).read_bytes()
        (run / name).write_text(content)
        tampered = tactorch("evaluate-model", f"run={run}", f"run_dir={tmp_path / 'tampered'}")
        assert tampered.status == 2
        assert len(tampered.err.splitlines()) == 1
        assert Path(name).name in tampered.err or "'data.folder' is missing" in tampered.err
        (run / name).write_bytes(before)
    shard = folder / "shard-00001.h5"
    changed = bytearray(shard.read_bytes())
    changed[len(changed) // 2] ^= 1
    (tmp_path / "shard").write_bytes(shard.read_bytes())
    shard.write_bytes(bytes(changed))
    for arguments in (("train", f"resume={run}"), ("evaluate-model", f"run={run}")):
        refused = tactorch(*arguments)
        assert refused.status == 2
        assert "shard-00001.h5' is damaged (its checksum" in refused.err
    shard.write_bytes((tmp_path / "shard").read_bytes())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("data.folder=nowhere",), ("dataset not found: 'nowhere'",)),
        (("model.hidden=0",), ("model.hidden=0", "at least 1")),
        (("trainer=gpu",), ("trainer=gpu needs a CUDA device",)),
        (("trainer.max_epochs=0",), ("max_epochs=0",)),
        (("data.shares=[0.5,0.5]",), ("data.shares", "three numbers")),
        (("data.shares=[0,0.5,0.5]",), ("data.shares: no object to train on",)),
        (("splits=0",), ("splits=0",)),
    ],
)
def test_wrong_settings_of_train(
    tactorch: Any, folder: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    import torch

    if "trainer=gpu" in arguments and torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    if not (folder / "manifest.json").is_file():
        tactorch("generate", *TINY, f"out={folder}")
    small = ("data.source=truth", "data.voxels=6", "trainer.max_epochs=1")
    given = (*small, f"data.folder={folder}", *arguments)
    done = tactorch("train", *given)
    assert done.status == 2
    assert len(done.err.splitlines()) == 1, done.err
    assert all(word in done.err for word in words), done.err
