"""The page in a real browser that has no network: it draws, moves, turns and prints."""

import dataclasses
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Open = Callable[..., Any]
SOLID = "canvas.gl"


def inner(pixels: np.ndarray) -> np.ndarray:
    """The middle of a slice, without axes and labels."""
    height, width = pixels.shape[:2]
    return pixels[height // 3 : height // 2, width // 3 : 2 * width // 3, :3]


def test_it_needs_nothing_but_itself(report: Path, visit: Open) -> None:
    seen = visit(report)
    seen.settle()
    assert seen.requests == [seen.address]
    assert not seen.troubles
    assert seen.page.locator("#error").is_hidden()
    assert "lump" in seen.page.locator("h1").inner_text().lower()


def test_sliders_move_their_slices_by_hand_and_by_keys(report: Path, visit: Open) -> None:
    seen = visit(report)
    for axis in "xyz":
        row = f".slice-row:has(#slice-{axis}) canvas"
        before = seen.pixels(row)
        assert len(np.unique(before.reshape(-1, 4), axis=0)) > 10
        seen.slide(f"#slice-{axis}", 1.7)
        assert (seen.pixels(row) != before).mean() > 0.01
        told = seen.page.locator(f"output[for=slice-{axis}]")
        assert told.inner_text() == f"{axis} = 1.70 mm"
        assert "1.70 mm" in seen.page.locator(row).first.get_attribute("aria-label")
    seen.page.focus("#slice-x")
    seen.page.keyboard.press("PageUp")
    seen.settle()
    assert seen.page.locator("output[for=slice-x]").inner_text() != "x = 1.70 mm"
    assert not seen.troubles


@pytest.mark.slow
def test_what_is_read_off_a_slice_is_the_map(run_folder: Path, report: Path, visit: Open) -> None:
    from tactorch.inverse import Reconstruction
    from tactorch.mesh import locate

    found = Reconstruction.load(run_folder / "reconstruction.h5")
    seen = visit(report)
    canvas = seen.page.locator(".slice-row:has(#slice-y) canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    compared = 0
    for across, up in ((0.5, 0.31), (0.41, 0.52), (0.71, 0.37), (0.62, 0.61)):
        canvas.hover(position={"x": across * box["width"], "y": up * box["height"]})
        text = seen.page.locator("#readout").inner_text()
        place = [float(v) for v in re.findall(r"[-\d.]+", text.split(")")[0])]
        value = float(re.search(r"Young's modulus ([\d.]+) MPa", text)[1])
        # The place is rounded to 0.1 mm: any element so near may be the one.
        near = np.array(place) + 0.05 * np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T
        elements = locate(found.mesh, near)
        assert np.isclose(found.youngs[elements[elements >= 0]], value, rtol=0.01).any(), text
        compared += 1
    assert compared == 4


@pytest.mark.slow
def test_a_slice_says_its_range(run_folder: Path, report: Path, visit: Open) -> None:
    from tactorch.inverse import Reconstruction

    found = Reconstruction.load(run_folder / "reconstruction.h5")
    seen = visit(report)
    seen.slide("#slice-x", 4.1)
    x = found.mesh.points[found.mesh.tets, 0]
    there = found.youngs[(x.min(axis=1) < 4.1) & (x.max(axis=1) > 4.1)]
    label = seen.page.locator(".slice-row:has(#slice-x) canvas").first.get_attribute("aria-label")
    told = [float(v) for v in label.split(":")[1].removesuffix(" MPa").split(" to ")]
    np.testing.assert_allclose(told, [there.min(), there.max()], rtol=0.006)


@pytest.mark.slow
def test_grey_is_grey_and_a_logarithm_changes_shades(report: Path, visit: Open) -> None:
    seen = visit(report)
    seen.page.uncheck("#outlines")
    coloured = inner(seen.pixels(".slice"))
    assert np.ptp(coloured, axis=2).max() > 30
    seen.page.select_option("#colours", "ultrasound")
    columns = [f".slice-row canvas:nth-of-type({k})" for k in (1, 2, 3, 4)]
    assert seen.page.locator(".head").count() == len(columns)
    for column in columns:
        assert np.ptp(inner(seen.pixels(column)), axis=2).max() <= 2
    grey = inner(seen.pixels(".slice"))
    seen.page.select_option("#scale", "log")
    assert (inner(seen.pixels(".slice")) != grey).any()
    assert not seen.troubles


@pytest.mark.slow
def test_the_body_turns_by_keys_and_by_hand(report: Path, visit: Open) -> None:
    seen = visit(report)
    first = seen.pixels(SOLID)
    assert (first[..., 3] > 0).mean() > 0.05
    seen.page.focus(SOLID)
    for _ in range(3):
        seen.page.keyboard.press("ArrowLeft")
    second = seen.pixels(SOLID)
    assert (second != first).mean() > 0.01
    box = seen.page.locator(SOLID).bounding_box()
    seen.page.mouse.move(box["x"] + 200, box["y"] + 200)
    seen.page.mouse.down()
    seen.page.mouse.move(box["x"] + 260, box["y"] + 230)
    seen.page.mouse.up()
    assert (seen.pixels(SOLID) != second).mean() > 0.01


def test_surface_and_cut_follow_their_controls(report: Path, visit: Open) -> None:
    seen = visit(report)
    whole = seen.pixels(SOLID)
    seen.slide("#level", 1000)
    other = seen.pixels(SOLID)
    # The surface is opaque, and gone where no modulus is so large.
    assert (whole[..., 3] == 255).sum() > (other[..., 3] == 255).sum() + 200
    seen.page.select_option("#cut", "1")
    cut = seen.pixels(SOLID)
    # The face of a cut is opaque, and the body is not.
    assert (cut[..., 3] == 255).sum() > 4 * (other[..., 3] == 255).sum()
    seen.slide("#cut-at", 800)
    moved = seen.pixels(SOLID)
    assert (moved != cut).mean() > 0.01
    assert seen.page.locator("output[for=slice-y]").inner_text() == "y = 8.00 mm"
    seen.page.check("#cut-flip")
    assert (seen.pixels(SOLID) != moved).mean() > 0.01


@pytest.mark.slow
def test_without_webgl_it_says_so_and_shows_the_rest(
    report: Path, launch: Callable[..., Any], open_in: Callable[..., Any]
) -> None:
    browser = launch("--disable-3d-apis")
    try:
        seen = open_in(browser, report)
        assert "needs WebGL" in seen.page.locator(".view .none").inner_text()
        assert seen.page.locator("#solid-controls").is_hidden()
        assert len(np.unique(seen.pixels(".slice").reshape(-1, 4), axis=0)) > 10
        assert seen.page.locator("#error").is_hidden()
    finally:
        browser.close()


@pytest.mark.slow
def test_paper_gets_fixed_slices_and_a_still(report: Path, visit: Open) -> None:
    seen = visit(report, color_scheme="dark")
    page = seen.page
    assert page.locator("#print-slices").is_hidden()
    page.emulate_media(media="print")
    page.wait_for_selector("#print-slices canvas")
    assert page.locator("#print-slices canvas").first.is_visible()
    assert page.locator("#print-slices p").count() == 9
    printed = seen.pixels("#print-slices div:not(.print-head) canvas")
    assert len(np.unique(printed.reshape(-1, 4), axis=0)) > 10
    assert page.locator("#slice-z").is_hidden()
    assert page.locator("img.still").is_visible()
    assert page.locator("img.still").get_attribute("src").startswith("data:image/png")
    assert page.locator("details:not([open])").count() == 0
    assert "residual" in page.locator("#press-summary").inner_text()
    assert "the isosurface of Young's modulus" in page.locator(".view .paper").inner_text()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    page.emulate_media(media="screen")
    page.wait_for_selector("#print-slices", state="hidden")
    # The rules of the page come before the event that tells its program.
    page.wait_for_function("!document.querySelector('details[open]')")


@pytest.mark.slow
def test_the_last_place_of_a_slider_shows_the_last_side(report: Path, visit: Open) -> None:
    seen = visit(report)
    seen.settle()
    for axis in "xyz":
        seen.page.locator(f"#slice-{axis}").press("End")
    seen.settle()
    told = seen.page.locator(".slice").evaluate_all(
        "all => all.map((one) => one.getAttribute('aria-label'))"
    )
    assert told
    assert not [one for one in told if "outside the body" in one]


@pytest.mark.slow
def test_dark_follows_the_system(report: Path, visit: Open) -> None:
    colour = "getComputedStyle(document.body).backgroundColor"
    light = visit(report, color_scheme="light").page.evaluate(colour)
    assert visit(report, color_scheme="dark").page.evaluate(colour) != light


@pytest.mark.slow
def test_everything_has_a_name(report: Path, visit: Open) -> None:
    """Each control and each picture says to a screen reader what it is."""
    seen = visit(report)
    seen.settle()
    nameless = seen.page.evaluate(
        """() => [...document.querySelectorAll("input, select, button, canvas, img")].filter((e) =>
            getComputedStyle(e).display !== "none" && !e.closest("[aria-hidden=true]")
            && !e.parentElement.classList.contains("head")
            && !(e.labels && e.labels.length) && !e.getAttribute("aria-label")
            && !e.textContent.trim()).map((e) => e.outerHTML)"""
    )
    assert nameless == []


@pytest.mark.slow
def test_a_press_is_chosen(report: Path, visit: Open) -> None:
    seen = visit(report)
    before, told = seen.pixels("#scatter"), seen.page.locator("#press-out").inner_text()
    assert re.search(r"residual [\d.]+ µm RMS, [\d.]+ standard deviations", told)
    seen.page.select_option("#press", "0")
    assert (seen.pixels("#scatter") != before).any()
    assert seen.page.locator("#press-out").inner_text() != told


def test_several_runs_share_sliders_and_colours(
    run_folder: Path, make_run: Any, visit: Open, tmp_path: Path
) -> None:
    from tactorch.inverse import GaussNewton, Settings
    from tactorch.report import load_run, write_report

    settings = Settings(optimizer=GaussNewton(max_iterations=6), regularization="smoothness")
    other = make_run(tmp_path / "second", settings)
    runs = [load_run(run_folder), load_run(other)]
    seen = visit(write_report(runs, tmp_path / "both.html", uncertainty=False))
    heads = seen.page.locator(".head strong").all_inner_texts()
    assert heads == ["first", "second", "Truth"]
    assert seen.page.locator(".view").count() == 2
    canvases = [f".slice-row:has(#slice-z) canvas:nth-of-type({k})" for k in (1, 2, 3)]
    before = [seen.pixels(canvas) for canvas in canvases]
    seen.slide("#slice-z", 2.2)
    assert all((seen.pixels(c) != b).any() for c, b in zip(canvases, before, strict=True))
    assert "regularization" in seen.page.locator("#settings table").first.inner_text()
    assert seen.page.locator("#scores td.best .mark").count() > 3
    # With a range for each column its colours and its bar change, and change back.
    seen.page.uncheck("#outlines")
    seen.page.select_option("#colours", "ultrasound")
    bars = [seen.pixels(f".head:nth-of-type({k}) canvas") for k in (1, 2)]
    common = [seen.pixels(canvas) for canvas in canvases]
    seen.page.select_option("#range", "own")
    assert any((seen.pixels(c) != b).any() for c, b in zip(canvases, common, strict=True))
    own = [seen.pixels(f".head:nth-of-type({k}) canvas") for k in (1, 2)]
    assert any((a != b).any() for a, b in zip(own, bars, strict=True))
    seen.page.select_option("#range", "common")
    assert all((seen.pixels(c) == b).all() for c, b in zip(canvases, common, strict=True))
    assert not seen.troubles


@pytest.mark.slow
def test_truths_that_differ_are_shown_apart(run_folder: Path, visit: Open, tmp_path: Path) -> None:
    from tactorch.report import load_run, write_report

    run = load_run(run_folder)
    recording = dataclasses.replace(run.recording, truth=2.0 * run.recording.truth)
    other = dataclasses.replace(run, name="other", recording=recording)
    seen = visit(write_report([run, other], tmp_path / "both.html", uncertainty=False))
    heads = seen.page.locator(".head strong").all_inner_texts()
    assert heads == ["first", "other", "Truth of first", "Truth of other"]


def test_text_from_outside_stays_text(run_folder: Path, visit: Open, tmp_path: Path) -> None:
    from tactorch.report import load_run, write_report

    name = '<img src=x onerror="window.bad=1"> & "quoted"'
    folder = Path(shutil.copytree(run_folder, tmp_path / name))
    (folder / "summary.txt").write_text("</pre></script><script>window.bad = 2</script>")
    run = load_run(folder)
    run.summary["recording"] = "</script><script>window.bad=3</script>"
    seen = visit(write_report([run], tmp_path / "report.html", uncertainty=False))
    assert seen.page.evaluate("window.bad === undefined")
    assert seen.page.locator(".subject").inner_text() == name
    assert not seen.troubles


@pytest.mark.parametrize(
    "name",
    [
        r"$\frac{$",
        "<script>window.bad = 1</script>",
        '"><img src=x onerror="window.bad=1">',
        "\x1b[31mred",
        "{{ 7 * 7 }}{% raw %}",
        "a\nb",
        "\u202egnp.exe",
        "long " * 60,
    ],
)
@pytest.mark.slow
def test_names_of_presses_stay_text(
    name: str, run_folder: Path, visit: Open, tmp_path: Path
) -> None:
    from tactorch.report import load_run, write_report
    from tactorch.text import one_line

    run = load_run(run_folder)
    assert run.recording is not None
    first, *others = run.recording.presses
    recording = dataclasses.replace(
        run.recording, presses=(dataclasses.replace(first, name=name), *others)
    )
    seen = visit(
        write_report(
            [dataclasses.replace(run, recording=recording)],
            tmp_path / "report.html",
            uncertainty=False,
        )
    )
    seen.page.select_option("#press", "0")
    seen.settle()
    assert seen.page.evaluate("window.bad === undefined")
    cell = seen.page.locator("#presses tbody th").first
    assert cell.text_content() == f"1: {one_line(name)}"
    assert (
        seen.page.locator("#press option").first.text_content().startswith(f"1: {one_line(name)}")
    )
    assert not seen.troubles
