"""The page of a live session, in a browser without a server."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.report import load_run
from tactorch.report.assessment import assess
from tactorch.report.content import RunReport
from tactorch.report.live import PAGE, SCRIPT, LivePage
from tactorch.sampling import Patch

NEXT = Patch(np.array([5.0, 5.0, 10.0]), np.array([0.0, 0.0, -1.0]), 1.5)
TEXTS = {"status": "1 presses", "headline": "Nothing yet", "finding": "", "next": ""}
COLUMNS = ("press", "finding")


@pytest.fixture
def assessed(run_folder: Path) -> RunReport:
    return assess(load_run(run_folder), uncertainty=False)


@pytest.fixture
def softer(assessed: RunReport) -> RunReport:
    """Another map on the same mesh."""
    result = replace(assessed.run.result, youngs=0.5 * assessed.run.result.youngs)
    return replace(assessed, run=replace(assessed.run, result=result))


def page(version: int, **changes: Any) -> LivePage:
    return LivePage(
        **{
            "name": "session.h5", "version": version, "texts": TEXTS, "columns": COLUMNS,
            **changes,
        }
    )  # fmt: skip


def script(folder: Path) -> dict[str, Any]:
    text = (folder / SCRIPT).read_text()
    content: dict[str, Any] = json.loads(
        text.removeprefix("window.tactorchLive(").removesuffix(");\n")
    )
    return content


def test_the_script_has_the_map_and_not_the_mesh(assessed: RunReport, tmp_path: Path) -> None:
    page(3, report=assessed, next_press=NEXT, rows=[["1", "x"]], notes=["</script>"]).write(
        tmp_path
    )
    content = script(tmp_path)
    assert content["version"] == 3
    assert not {"points", "tets", "surface"} & set(content["run"])
    assert content["run"]["next"] == {
        "center": [5.0, 5.0, 10.0], "inward": [0.0, 0.0, -1.0], "radius": 1.5,
    }  # fmt: skip
    assert content["notes"] == ["</script>"]
    whole = (tmp_path / PAGE).read_text()
    assert whole.count("</script>") == 2
    assert "&lt;/script&gt;" in whole
    assert len((tmp_path / SCRIPT).read_text()) < 0.5 * len(whole)


def test_before_the_first_press_there_is_no_viewer(tmp_path: Path) -> None:
    page(1).write(tmp_path)
    assert "<canvas" not in (tmp_path / PAGE).read_text()
    assert script(tmp_path)["run"] is None


def test_an_open_page_is_updated_without_reloading(
    browser: Any, assessed: RunReport, softer: RunReport, tmp_path: Path
) -> None:
    page(1).write(tmp_path)
    tab = browser.new_page()
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto((tmp_path / PAGE).as_uri())
    assert tab.inner_text("h1") == "Nothing yet"
    assert tab.query_selector("canvas") is None

    # The first map reloads the page, which then has the viewer.
    page(2, report=assessed, texts={**TEXTS, "headline": "A lump"}).write(tmp_path)
    tab.wait_for_selector("canvas.gl", timeout=8000)
    assert tab.inner_text("h1") == "A lump"
    tab.evaluate("window.mark = 1")
    tab.locator("#slice-z").fill("3")
    tab.wait_for_timeout(200)
    before = tab.evaluate("document.querySelector('canvas.slice').toDataURL()")

    texts = {**TEXTS, "headline": "A softer lump", "next": "Press next: <b>here</b>"}
    changes = {"texts": texts, "rows": [["2", "<i>soft</i>"], ["1", "y"]], "notes": ["a warning"]}
    page(3, report=softer, next_press=NEXT, ended=True, **changes).write(tmp_path)
    tab.get_by_text("A softer lump").wait_for(timeout=8000)
    tab.wait_for_timeout(300)
    assert tab.evaluate("window.mark") == 1, "the page was loaded again"
    assert tab.inner_text("#next") == "Press next: <b>here</b>"
    assert tab.inner_text("#notes") == "a warning"
    assert tab.inner_text("#updates tbody tr:first-child td") == "<i>soft</i>"
    assert len(tab.query_selector_all("#updates tbody tr")) == 2
    assert float(tab.input_value("#slice-z")) == pytest.approx(3.0, abs=0.1)
    assert tab.evaluate("document.querySelector('canvas.slice').toDataURL()") != before
    assert "next press" in tab.inner_text("#legend")

    # After the end it asks for no more.
    page(4, report=softer, texts={**TEXTS, "headline": "Later"}).write(tmp_path)
    tab.wait_for_timeout(2500)
    assert tab.inner_text("h1") == "A softer lump"
    assert not errors
    tab.close()
