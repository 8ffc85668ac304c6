"""Text from files is drawn as it is, whatever it holds."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from tactorch.mesh import box_mesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.text import MAX_NAME_LENGTH, one_line, printable
from tactorch.viz import calibration_figure, convergence_figure, layer_figure, save_figure
from tactorch.viz.figure import new_figure
from tactorch.viz.learning import confusion_figure
from tactorch.viz.presses import presses_figure

HOSTILE = [
    r"$\frac{$",
    r"a $x$ b $\undefined{y}$",
    "<script>alert(1)</script>&amp;",
    "\x1b[31mred\x1b[0m\x07",
    "../../x",
    "two\nlines\r\nthree",
    "long " * 200,
    "\u202egnp.exe\u2066",
    "\u05e9\u05dc\u05d5\u05dd",
    "\ud800",
    "",
]
HISTORY = [{"iteration": i, "seconds": 1.0 * i, "misfit": 0.1**i} for i in range(3)]


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("suffix", [pytest.param(".png", marks=pytest.mark.slow), ".svg"])
@pytest.mark.filterwarnings("ignore:Glyph:UserWarning")
def test_names_of_presses_are_drawn_literally(name: str, suffix: str, tmp_path: Path) -> None:
    mesh = box_mesh(10.0, 2)
    top = np.repeat(mesh.points[:, 2:] > 9.99, 3, axis=1)
    down = np.array([0.0, 0.0, -1.0])
    press = Press(
        np.where(top, 0.1 * down, 0.0), top, np.where(top, 0.1 * down, np.nan),
        fixed=np.repeat(mesh.points[:, 2:] < 0.01, 3, axis=1), name=name,
    )  # fmt: skip
    recording = Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.45))
    path = save_figure(presses_figure(recording), tmp_path / f"presses{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if suffix == ".svg":
        ElementTree.parse(path)


@pytest.mark.parametrize(
    "name", [*HOSTILE[:4], *(pytest.param(name, marks=pytest.mark.slow) for name in HOSTILE[4:])]
)
@pytest.mark.filterwarnings("ignore:Glyph:UserWarning")
def test_legends_ticks_and_titles_are_drawn_literally(name: str, tmp_path: Path) -> None:
    label = name or "empty"
    for figure in (
        convergence_figure({label: HISTORY}, title=name),
        calibration_figure({label: np.linspace(0, 1, 5)}, title=name),
        layer_figure({label: (np.arange(3.0), np.ones(3))}, title=name),
    ):
        save_figure(figure, tmp_path / "figure.svg")
        ElementTree.parse(tmp_path / "figure.svg")
    figure = confusion_figure(np.eye(2, dtype=int), (name, "b"))
    save_figure(figure, tmp_path / "confusion.png")


def test_logarithmic_ticks_stay_typeset(tmp_path: Path) -> None:
    figure = new_figure(4.0, 3.0)
    axes = figure.subplots()
    axes.semilogy([0, 1, 2], [1e-6, 1.0, 1e6])
    axes.set_title("$x$")
    save_figure(figure, tmp_path / "log.png")
    ticks = [label for label in axes.get_yticklabels() if label.get_text()]
    assert ticks
    assert all(label.get_parse_math() for label in ticks)
    others = [text for text in figure.findobj(Text) if text.get_text() == "$x$"]
    assert others
    assert not any(text.get_parse_math() for text in others)


@pytest.mark.parametrize("name", HOSTILE)
def test_one_line_has_no_control_characters(name: str) -> None:
    line = one_line(name)
    assert len(line) <= MAX_NAME_LENGTH
    assert line.isprintable()
    line.encode()  # no lone surrogate


def test_printable_text_keeps_its_lines() -> None:
    assert printable("a\n\tb\x1b[2J\u202e") == "a\n\tb\\x1b[2J\\u202e"
