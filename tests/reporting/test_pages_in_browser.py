"""Pages in Chromium, on a desk, on a phone and on paper: nothing complains, nothing sticks out, hovering is linked."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("websockets")
from browser import CHROMIUM, Page, browse

from compplan.io.notes import Stop
from compplan.reporting.plan_page import write_plan_page
from tests.reporting.test_report import make_plan

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]
DRAWN = (
    "(() => { const plots = [...document.querySelectorAll('.plot')]; "
    "return plots.length > 3 && plots.every((plot) => plot._fullLayout); })()"
)

FIRST = "Boolean(document.querySelector('.opening .plot')._fullLayout)"


def unfold(page: Page) -> None:
    """Open every fold of the page and wait for its charts."""
    page.run("document.getElementById('unfold').click()")
    page.wait(DRAWN)


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browse() as opened:
        yield opened


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_plan_page(replace(make_plan(), notes=(Stop("SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN"),)), file)
    return file


@pytest.mark.parametrize("width", [1300, 390])
def test_a_page_opens_without_a_complaint_and_as_wide_as_the_window(page: Page, file: Path, width: int) -> None:
    page.open(file.as_uri(), width)
    unfold(page)
    assert page.complaints == []
    assert page.run("document.documentElement.scrollWidth") <= width


def test_a_waypoint_that_is_hovered_in_one_chart_is_shown_in_the_others(page: Page, file: Path) -> None:
    page.open(file.as_uri(), 1300, 6000)
    unfold(page)
    box = page.run("document.getElementById('chart-1').getBoundingClientRect().toJSON()")
    for shift in (0, 6):
        page.point_at(box["x"] + 0.5 * box["width"] + shift, box["y"] + 0.5 * box["height"])
    page.run("new Promise((done) => setTimeout(done, 2500))")
    shown = page.run(
        "[...document.querySelectorAll('.plot')].map((p) => p.querySelectorAll('.hoverlayer .hovertext, "
        ".hoverlayer .legend').length + ((p._fullLayout.scene || {}).annotations || []).length)"
    )
    assert sum(count > 0 for count in shown) >= 4
    assert page.complaints == []


def test_everything_that_can_be_clicked_is_reached_and_used_by_the_keyboard(page: Page, file: Path) -> None:
    page.open(file.as_uri(), 1300)
    page.wait(FIRST)
    wanted = page.run("document.querySelectorAll('nav a, button:not([hidden]), summary, .scroll').length")
    page.run("document.activeElement.blur()")
    told = "(() => { const e = document.activeElement; return [e.tagName, e.id, getComputedStyle(e).outlineStyle]; })()"
    met = []
    for _ in range(wanted + 10):
        page.press("Tab")
        tag, name, outline = page.run(told)
        if tag == "BODY":
            break
        met.append(tag)
        assert outline != "none", (tag, name)
        if name == "theme":
            before = page.run("document.documentElement.dataset.theme")
            page.press("Enter")
            assert page.run("document.documentElement.dataset.theme") != before
            page.press("Enter")
        if tag == "SUMMARY":
            was = page.run("document.activeElement.parentElement.open")
            page.press("Enter")
            assert page.run("document.activeElement.parentElement.open") != was
            if was:
                page.press("Enter")
    assert len(met) >= wanted
    assert {"BUTTON", "A", "SUMMARY", "DIV"} <= set(met)


def test_a_finger_on_a_chart_scrolls_the_page_and_turns_a_scene_only_after_its_button(page: Page, file: Path) -> None:
    camera = "JSON.stringify(document.getElementById('chart-2')._fullLayout.scene._scene.getCamera().eye)"
    page.ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=1)
    try:
        page.open(file.as_uri(), 390, 844)
        unfold(page)
        for chart in range(4):
            node = f"document.getElementById('chart-{chart}')"
            page.run(f"{node}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
            box, before = page.run(f"{node}.getBoundingClientRect().toJSON()"), page.run("scrollY")
            page.swipe(180, box["y"] + 0.5 * box["height"], 150)
            assert page.run("scrollY") > before + 50, chart
        eye = page.run(camera)
        page.run("document.querySelector('#chart-2 .turn').click()")
        page.run("document.getElementById('chart-2').scrollIntoView({block: 'center', behavior: 'instant'})")
        box = page.run("document.getElementById('chart-2').getBoundingClientRect().toJSON()")
        page.swipe(180, box["y"] + 0.5 * box["height"], 100)
        assert page.run(camera) != eye
    finally:
        page.ask("Emulation.setTouchEmulationEnabled", enabled=False)


def test_the_page_prints_with_its_scenes(page: Page, file: Path, tmp_path: Path) -> None:
    page.open(file.as_uri(), 1300)
    unfold(page)
    page.run("window.dispatchEvent(new Event('beforeprint'))")
    pictures = page.run(
        "[...document.querySelectorAll('img.frozen')].map((i) => i.src.length / (i.src.length + 1000) > 0.9)"
    )
    assert len(pictures) == 3 and all(pictures)
    widest = page.run(
        "Math.max(...[...document.querySelectorAll('.plot')].map((p) => p.getBoundingClientRect().width))"
    )
    page.run("window.dispatchEvent(new Event('afterprint'))")
    assert widest <= 1300
    page.save_print(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").stat().st_size > 50_000
    assert page.complaints == []


@pytest.mark.parametrize("width", [1300, 390])
def test_the_first_screen_says_verdict_stops_three_figures_and_the_next_step(
    page: Page, file: Path, width: int
) -> None:
    page.open(file.as_uri(), width, 900 if width > 400 else 844)
    page.wait(FIRST)
    ends = page.run(
        "['.verdict', '.stops', '.figures', '.next']"
        ".map((name) => document.querySelector(name).getBoundingClientRect().bottom)"
    )
    assert max(ends) <= 844
    assert page.run("document.querySelectorAll('.figures li').length") == 3
    if width > 400:
        assert page.run("document.querySelector('.opening .plot').getBoundingClientRect().bottom") <= 900
    assert page.run("[...document.querySelectorAll('details.section[open]')].length") == 1


def test_no_script_but_the_pages_own_runs_and_nothing_is_fetched(page: Page, file: Path) -> None:
    page.open(file.as_uri(), 1300)
    page.wait(FIRST)
    assert page.complaints == []
    page.run(
        "(() => { const s = document.createElement('script'); s.textContent = 'window.strange = 1'; "
        "document.head.append(s); const i = document.createElement('img'); i.src = 'https://example.org/x.png'; "
        "document.body.append(i); })()"
    )
    page.run("new Promise((done) => setTimeout(done, 500))")
    assert page.run("window.strange === undefined")
    assert sum("Content Security Policy" in told for told in page.complaints) >= 2
    page.complaints.clear()


def test_paper_shows_what_is_open_in_few_numbered_pages(page: Page, file: Path, tmp_path: Path) -> None:
    page.open(file.as_uri(), 1300)
    page.wait(FIRST)
    page.save_print(tmp_path / "few.pdf")
    unfold(page)
    page.save_print(tmp_path / "all.pdf")
    few, every = (read_pages(tmp_path / name) for name in ("few.pdf", "all.pdf"))
    assert len(few) == 2 < len(every)
    assert "page 1 of 2" in few[0] and "page 2 of 2" in few[1] and "Setup sheet" in few[1]
    assert "Joints" not in "".join(few) and "Joints" in "".join(every)


def read_pages(file: Path) -> list[str]:
    """Text of every page of a PDF."""
    tool = shutil.which("pdftotext")
    if tool is None:
        pytest.skip("needs pdftotext")
    return subprocess.run([tool, str(file), "-"], capture_output=True, text=True, check=True).stdout.split("\f")[:-1]
