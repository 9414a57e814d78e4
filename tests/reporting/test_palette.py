"""Colours of pages: contrast by WCAG 2.2, and what is left of their differences to who sees two primaries only."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import compplan.reporting
from compplan.reporting import style

CSS = Path(compplan.reporting.__file__).parent / "templates" / "page.css"
#: Linear RGB as seen with one kind of cone missing, severity 1 [Machado, Oliveira, Fernandes 2009].
SIGHT = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
#: A difference of 2.3 is just seen in two large patches [Mahy 1994]; thin lines and dots need many times that.
APART = 15.0


def linear(colour: str) -> np.ndarray:
    """Linear RGB of #rrggbb [IEC 61966-2-1]."""
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Contrast ratio [WCAG 2.2]."""
    light, dark = sorted((float(linear(colour) @ TO_XYZ[1]) for colour in (one, other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def difference(one: str, other: str, sight: str) -> float:
    """CIE 1976 colour difference as seen."""
    labs = []
    for colour in (one, other):
        xyz = TO_XYZ @ np.clip(np.asarray(SIGHT[sight]) @ linear(colour), 0, 1) / (TO_XYZ @ np.ones(3))
        f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
        labs.append(np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])]))
    return float(np.linalg.norm(labs[0] - labs[1]))


def variables(theme: str) -> dict[str, str]:
    """Colours that the style sheet names."""
    text = CSS.read_text(encoding="utf-8")
    block = re.search(r':root\[data-theme="dark"\] \{(.*?)\}' if theme == "dark" else r":root \{(.*?)\}", text, re.S)
    assert block
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block.group(1)))


def test_the_tool_knows_black_white_and_red_green() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    assert difference("#d03030", "#707020", "deuteranopia") < 0.4 * difference("#d03030", "#707020", "all cones")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_is_read_on_everything_that_it_stands_on(theme: str) -> None:
    colours = variables(theme)
    for name in ("ink", "quiet", "accent", "good", "bad", "assumed"):
        assert contrast(colours[name], colours["paper"]) >= 4.5, name
    assert contrast(colours["ink"], colours["warning-band"]) >= 4.5
    assert contrast(colours["ink"], colours["assumed-band"]) >= 4.5
    assert contrast(style.INK[theme], style.PAPER[theme]) >= 4.5
    assert style.PAPER[theme] == colours["paper"]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_lines_and_dots_stand_out_from_the_paper(theme: str) -> None:
    for colour in (style.BEFORE, style.AFTER, style.TOLERANCE, style.LIMIT, style.NEUTRAL, *style.CATEGORIES):
        assert contrast(colour, style.PAPER[theme]) >= 3.0, colour


@pytest.mark.parametrize("sight", list(SIGHT))
def test_categories_and_roles_are_told_apart_by_everybody(sight: str) -> None:
    groups = (style.CATEGORIES, (style.BEFORE, style.AFTER, style.TOLERANCE))
    for one, other in (pair for group in groups for pair in combinations(group, 2)):
        assert difference(one, other, sight) >= APART, (one, other)
    for (_, one), (_, other) in combinations(style.SEQUENTIAL, 2):
        assert difference(one, other, sight) >= APART, (one, other)


def test_more_lines_than_colours_take_another_dash() -> None:
    looks = [tuple(style.style_line(number).values()) for number in range(13)]
    assert len(set(looks)) == 13
