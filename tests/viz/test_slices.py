from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.mesh import TetMesh
from tactorch.viz import save_figure, slice_figure

# Slices near the middle of the sphere, and those that miss it by more than a cell.
WITHIN = ["x = 14 mm", "y = 6 mm", "z = 10 mm", "z = 14 mm"]
BEYOND = ["x = 2 mm", "x = 6 mm", "y = 14 mm", "y = 18 mm", "z = 2 mm"]
SURE = {*WITHIN, *BEYOND}
QUICK = {"n_slices": 2, "pixels": 24}


def panels(figure: Figure) -> list:
    return [axes for axes in figure.axes if axes.images]


def close_to(picture: np.ndarray, colour: str) -> int:
    """Count the pixels of a picture in a colour."""
    return int((np.abs(picture[..., :3] - to_rgb(colour)).max(axis=-1) < 0.02).sum())


def test_written_picture_shows_inclusion_background_and_contact(
    cube: TetMesh, sphere_map: np.ndarray, tmp_path: Path
) -> None:
    figure = slice_figure(cube, sphere_map, pressed=["z+"], n_slices=3)
    path = save_figure(figure, tmp_path / "run" / "a.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    picture = imread(path)
    assert close_to(picture, "#fde725") > 1000  # the top of viridis: 1 MPa
    assert close_to(picture, "#414487") > 10_000  # its value at 0.2 of 1 MPa
    assert close_to(picture, "#D55E00") > 500
    assert [p.name for p in path.parent.iterdir()] == ["a.png"]


def test_rows_are_axes_and_columns_positions(cube: TetMesh, sphere_map: np.ndarray) -> None:
    figure = slice_figure(cube, sphere_map, n_slices=5, pixels=20)
    shown = panels(figure)
    assert len(shown) == 15
    expected = [f"{axis} = {at} mm" for axis in "xyz" for at in (2, 6, 10, 14, 18)]
    assert [axes.get_title() for axes in shown] == expected
    found = {axes.get_title(): bool((axes.images[0].get_array() == 1.0).any()) for axes in shown}
    assert [at for at, hit in found.items() if hit and at in SURE] == WITHIN
    # Seen across x at 14 mm: y 6 mm, z 12 mm, row 0 at the bottom.
    rows, columns = np.nonzero(shown[3].images[0].get_array() == 1.0)
    np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], [6.0, 12.0], atol=0.7)
    assert shown[3].images[0].origin == "lower"


def test_one_colour_scale_with_units(cube: TetMesh, sphere_map: np.ndarray) -> None:
    figure = slice_figure(cube, 0.5 * sphere_map, truth=sphere_map, **QUICK)
    assert {(axes.images[0].norm.vmin, axes.images[0].norm.vmax) for axes in panels(figure)} == {
        (0.0, 1.0)
    }
    bars = [axes.get_ylabel() for axes in figure.axes if not axes.images]
    assert bars == ["Young's modulus (MPa)"]


def test_truth_gets_rows_of_its_own_and_an_outline(cube: TetMesh, sphere_map: np.ndarray) -> None:
    flat = np.full(cube.n_tets, 0.2)
    shown = panels(slice_figure(cube, flat, truth=sphere_map, n_slices=5, pixels=30))
    assert len(shown) == 30
    across_x, truth_x = shown[3], shown[8]
    assert across_x.get_title() == "x = 14 mm"
    assert "reconstruction" in shown[0].get_ylabel()
    assert "truth" in shown[5].get_ylabel()
    assert float(across_x.images[0].get_array().max()) == 0.2
    assert float(truth_x.images[0].get_array().max()) == 1.0
    outline = [c for c in across_x.collections if hasattr(c, "levels")]
    assert outline
    vertices = np.concatenate([p.vertices for p in outline[0].get_paths()])
    np.testing.assert_allclose(vertices.mean(axis=0), [6.0, 12.0], atol=0.8)
    assert not [c for c in shown[0].collections if hasattr(c, "levels")]
    only = slice_figure(cube, flat, truth=sphere_map, truth_rows=False, **QUICK)
    assert len(panels(only)) == 6


def test_truth_that_varies_everywhere_has_no_outline(cube: TetMesh) -> None:
    texture = 0.5 + 0.4 * np.sin(cube.centroids.sum(axis=1))
    shown = panels(slice_figure(cube, texture, truth=texture, **QUICK))
    assert not [c for axes in shown for c in axes.collections if hasattr(c, "levels")]


def test_lone_wild_elements_do_not_wash_out_the_colours(
    cube: TetMesh, sphere_map: np.ndarray
) -> None:
    wild = sphere_map.copy()
    wild[:3] = 100.0
    norm = panels(slice_figure(cube, wild, **QUICK))[0].images[0].norm
    assert norm.vmax == pytest.approx(4.0)


def test_scale_can_be_logarithmic_or_given(cube: TetMesh, sphere_map: np.ndarray) -> None:
    norm = panels(slice_figure(cube, sphere_map, scale="log", **QUICK))[0].images[0].norm
    assert isinstance(norm, LogNorm)
    assert (norm.vmin, norm.vmax) == pytest.approx((0.2, 1.0))
    given = slice_figure(cube, sphere_map, limits_mpa=(0.1, 0.5), **QUICK)
    assert (panels(given)[0].images[0].norm.vmin, panels(given)[0].images[0].norm.vmax) == (
        0.1,
        0.5,
    )


def test_uniform_map_can_be_drawn(cube: TetMesh, tmp_path: Path) -> None:
    uniform = np.full(cube.n_tets, 0.2)
    for scale in ("linear", "log"):
        figure = slice_figure(cube, uniform, scale=scale, **QUICK)
        path = save_figure(figure, tmp_path / f"{scale}.png")
        assert path.stat().st_size > 0


def test_values_that_do_not_fit_are_refused(cube: TetMesh, sphere_map: np.ndarray) -> None:
    with pytest.raises(TactorchError, match=r"youngs: shape \(3071,\) .* 3072 tetrahedra"):
        slice_figure(cube, sphere_map[1:])
    with pytest.raises(TactorchError, match="truth: shape"):
        slice_figure(cube, sphere_map, truth=sphere_map[:5])
    broken = sphere_map.copy()
    broken[[7, 9]] = np.nan
    with pytest.raises(TactorchError, match=r"youngs: 2 of 3072 .* element 7"):
        slice_figure(cube, broken)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"scale": "sqrt"}, "linear or log"),
        ({"cmap": "virdis"}, "virdis"),
        ({"n_slices": 0}, "n_slices"),
        ({"pixels": 1}, "pixels"),
        ({"limits_mpa": (1.0, 0.5)}, "limits_mpa"),
        ({"scale": "log", "limits_mpa": (0.0, 1.0)}, "above zero"),
    ],
)
def test_unusable_settings_are_refused(
    cube: TetMesh, sphere_map: np.ndarray, setting: dict, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        slice_figure(cube, sphere_map, **setting)


def test_unknown_picture_format_is_refused_and_nothing_written(
    cube: TetMesh, sphere_map: np.ndarray, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="bmp"):
        save_figure(slice_figure(cube, sphere_map, **QUICK), tmp_path / "a.bmp")
    assert not list(tmp_path.iterdir())


def test_failed_write_keeps_the_old_picture(
    cube: TetMesh, sphere_map: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def broken(self: Figure, target: Path, **_: object) -> None:
        Path(target).write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", broken)
    with pytest.raises(FileError, match=r"a\.png': disk full"):
        save_figure(slice_figure(cube, sphere_map, **QUICK), path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
