"""Chains of robots as the description packages state them (tests/robot/sources.toml), read without the package.

A row a joint: origin xyz [m], rpy [rad], axis; `tool` is tool0 behind the last joint. `work` is a posture with the
elbow up and the tool down [deg]; `reach` is what the maker states from axis 1 to the wrist centre [mm], if known.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple


class Source(NamedTuple):
    """One arm as its description package states it."""

    mass: float
    work: tuple[float, ...]
    joints: tuple[tuple[float, ...], ...]
    tool: tuple[float, ...]
    reach: int | None = None


_TABLE = tomllib.loads((Path(__file__).parents[1] / "robot" / "sources.toml").read_text(encoding="utf-8"))
SOURCES = {name: Source(**entry) for name, entry in _TABLE.items()}
