"""Pages in Chromium, on a desk, on a phone and on paper: nothing complains, nothing sticks out, hovering is linked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("websockets")
from browser import CHROMIUM, Page, browse
from test_report import make_view

from compplan.report.plan_page import write_view

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]
DRAWN = (
    "(() => { const plots = [...document.querySelectorAll('.plot')]; "
    "return plots.length > 3 && plots.every((plot) => plot._fullLayout); })()"
)


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browse() as opened:
        yield opened


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_view(make_view(), file)
    return file


@pytest.mark.parametrize("width", [1300, 390])
def test_a_page_opens_without_a_complaint_and_as_wide_as_the_window(page: Page, file: Path, width: int) -> None:
    page.open(file.as_uri(), width)
    page.wait(DRAWN)
    assert page.complaints == []
    assert page.run("document.documentElement.scrollWidth") <= width


def test_a_waypoint_that_is_hovered_in_one_chart_is_shown_in_the_others(page: Page, file: Path) -> None:
    page.open(file.as_uri(), 1300, 3000)
    page.wait(DRAWN)
    box = page.run("document.getElementById('chart-0').getBoundingClientRect().toJSON()")
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
    page.wait(DRAWN)
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
            page.press("Enter")
            assert page.run("document.activeElement.parentElement.open")
    assert len(met) >= wanted
    assert {"BUTTON", "A", "SUMMARY", "DIV"} <= set(met)


def test_the_page_prints_with_its_scenes(page: Page, file: Path, tmp_path: Path) -> None:
    page.open(file.as_uri(), 1300)
    page.wait(DRAWN)
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
