"""Evidence is generated: README and manual quote figures from docs/results alone, and say things simply."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import textstat

from benchmarks.results import PAGES
from benchmarks.results.diagnosis_real import count_published

ROOT = Path(__file__).parents[2]
#: The pages of `benchmarks results` that have been measured; `benchmarks nlp` writes its own.
WRITTEN = sorted(file.stem for file in (ROOT / "docs" / "results").glob("*.md") if file.stem in PAGES)
README = (ROOT / "README.md").read_text(encoding="utf-8")
FIGURE = re.compile(r"(?<![\w.])\d+(?:[.,]\d+)*(?![\w.])")
LINK = re.compile(r"docs/results/(\w+)\.md")


def read_section(page: str, title: str) -> str:
    """Return the text below a heading of a page."""
    text = (ROOT / "docs" / "results" / f"{page}.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {title}\n\n(.+?)(?=^## |\Z)", text, re.M | re.S)
    assert found, f"{page} has no section {title}"
    return found[1]


def list_quotes() -> list[tuple[str, str]]:
    """Return the paragraphs and items of the README that link to a page of results, with the name of the page."""
    blocks = re.split(r"\n\n|\n(?=- )", README)
    return [(block, link) for block in blocks for link in LINK.findall(block) if link != "index"]


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_of_results_says_question_losses_limits_and_where_it_comes_from(name: str) -> None:
    text = (ROOT / "docs" / "results" / f"{name}.md").read_text(encoding="utf-8")
    assert name in (ROOT / "docs" / "results" / "index.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {PAGES[name].TITLE}\n\n**Question.** {PAGES[name].QUESTION}")
    for title in ("In short", "What falls short", "How it was measured", "Limitations"):
        assert len(read_section(name, title).split()) > 4
    made = read_section(name, "Made by")
    assert f"python -m benchmarks results {name}" in made
    assert re.search(r"\d{4}-\d\d-\d\d, commit [0-9a-f]{7,}", made) and "casadi" in made and "cores" in made


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_of_results_opens_with_a_chart_and_few_words(name: str) -> None:
    text = (ROOT / "docs" / "results" / f"{name}.md").read_text(encoding="utf-8")
    assert len(text.partition("\n|")[0].split()) <= 400
    assert f"](charts/{name}.png)" in text and hasattr(PAGES[name], "CHART")


def test_every_figure_of_the_readme_about_accuracy_stands_in_the_page_that_it_links() -> None:
    quotes = list_quotes()
    assert len(quotes) >= 4
    for block, page in quotes:
        links = set(LINK.findall(block))
        known = {figure for link in links for figure in FIGURE.findall(read_section(link, "In short"))}
        said = set(FIGURE.findall(re.sub(r"\(docs/[^)]*\)", "", block)))
        assert said - {"95"} <= known, f"{page}: {sorted(said - known)} stand in the README alone"


def test_the_readme_is_short_and_holds_no_evidence_of_its_own() -> None:
    assert README.count("\n") <= 110 and len(README.split()) <= 1500
    assert not re.findall(r"\b(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7,}\b", README)
    assert not re.findall(r"\bseeds?\b", README)


def test_every_file_that_the_readme_links_is_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)", README):
        assert (ROOT / target).exists(), target


def test_the_glossary_has_at_most_thirty_terms() -> None:
    rows = re.findall(r"^\| [^-|]+ \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.M)
    assert 20 <= len(rows) - 1 <= 30


def read_prose(file: Path) -> str:
    """Return the sentences of a page: no code, tables, headings or link targets."""
    text = re.sub(r"```.*?```", "", file.read_text(encoding="utf-8"), flags=re.S)
    text = re.sub(r"^(    |\||#+ ).*$", "", text, flags=re.M)
    assert len(text.split()) > 100
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"\n- ", "\n\n", re.sub(r"[*`]", "", text))


FIRST_PAGES = ("README.md", "docs/first_part.md", "docs/loop.md", "docs/programs.md", "docs/limits.md")


@pytest.mark.parametrize("name", FIRST_PAGES)
def test_first_pages_read_at_school_grade_ten_or_below(name: str) -> None:
    assert textstat.flesch_kincaid_grade(read_prose(ROOT / name)) <= 10.0


def test_published_causes_of_a_robot_count_by_their_effect_and_joint() -> None:
    claims = [{"effect": "gravity_sag", "joint": None}, {"effect": "transmission_error", "joint": "elbow_joint"},
              {"effect": "transmission_error", "joint": "wrist_1_joint"}]  # fmt: skip
    assert count_published("ur10_b_whole", claims) == (2, 5)
    assert count_published("ur5_0015", claims) == (1, 2)
    assert count_published("another_robot", claims) == (0, 0)
