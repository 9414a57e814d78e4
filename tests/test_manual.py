"""The manual: its links lead somewhere, every page is reached, and slowly its first part is cut as it says."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from compplan.cli import COMMANDS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(file for file in DOCS.rglob("*.md") if not file.is_relative_to(DOCS / "notebooks"))


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_to_a_file_leads_to_one(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", read(page))
    assert not [link for link in links if not (page.parent / link).exists()]


def test_every_page_stands_in_a_table_of_contents() -> None:
    listed = set(re.findall(r"^([\w/]+)$", read(DOCS / "index.md") + read(DOCS / "gallery.md"), re.M))
    for folder in ("api", "results"):  # tables of contents of their own
        listed |= {f"{folder}/{name}" for name in re.findall(r"^(\w+)$", read(DOCS / folder / "index.md"), re.M)}
    assert {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES} <= listed | {"index"}


def test_the_manual_has_at_most_22_thousand_words() -> None:
    assert sum(len(read(page).split()) for page in PAGES) <= 22_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_files_of_the_package_that_a_page_names_exist(page: Path) -> None:
    text = read(page)
    for command in re.findall(r"`compplan (\w+)[ `]", text) + re.findall(r"^\$ compplan (\w+)", text, re.M):
        assert command in COMMANDS or command == "view", command
    for path in re.findall(r"`((?:compplan|tests|benchmarks|robots|examples)/[\w/.]+)`", text):
        assert (ROOT / path).exists(), path
    for module in re.findall(r"`(compplan(?:\.\w+)+)`", text):
        parts = module.split(".")
        places = [ROOT.joinpath(*parts[:k]) for k in (len(parts), len(parts) - 1)]
        assert any(place.is_dir() or place.with_suffix(".py").is_file() for place in places), module


@pytest.mark.slow
def test_the_first_part_of_the_manual_is_planned_by_its_own_commands(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples" / "first_part", tmp_path / "examples" / "first_part")
    blocks = re.findall(r"^```console\n(.*?)^```", read(DOCS / "first_part.md"), re.M | re.S)
    folder = tmp_path
    for line in re.findall(r"^\$ (.+)$", "\n".join(blocks), re.M):
        if line.startswith("cd "):
            folder = folder / line[3:]
            continue
        words = line.split()
        command = [sys.executable, "-m", *words] if words[0] == "compplan" else words
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env={**os.environ,
                              "PYTHONPATH": str(ROOT)}, check=False)  # fmt: skip
        assert done.returncode == 0, (line, done.stderr)
    assert list((folder / "out").glob("*_L1.src")) and (folder / "out" / "report.html").is_file()
    assert (folder / "compare" / "compare.json").is_file() and (folder / "forces" / "forces.json").is_file()


def test_the_reference_lists_every_robot_and_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("docutils")  # of the extra docs
    monkeypatch.syspath_prepend(DOCS / "_ext")
    tables = importlib.import_module("reference_tables")
    assert tables.list_robots()[22][:5] == ("kuka_kr16_2", "16 kg", "1.61 m", "6", "x of flange")
    assert len(tables.list_effects()) == 21
    for page, directive in (
        ("robots", "robot-table"),
        ("concepts/diagnosis", "effect-table"),
        ("job_keys", "commented-job"),
    ):
        assert f"```{{{directive}}}\n```" in read(DOCS / f"{page}.md")
