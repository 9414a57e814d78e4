"""Robot folders that a parametrised test runs over: a spread of eight; the others are slow."""

from __future__ import annotations

from typing import Any

import pytest

from compplan.robot import robot_folders

#: A spread: six makes, 36 springs, a rail, seven joints, a parallelogram's coupling.
OFTEN = {
    "abb_irb6640_185_280", "fanuc_m10ia", "franka_fr3", "kuka_kr240_rail", "kuka_kr270_full", "staubli_tx200", "ur10e",
    "yaskawa_gp25",
}  # fmt: skip
#: Seven joints turn: no branches to list, no words that tell them apart.
REDUNDANT = {"franka_fr3"}


def over_robots(*, redundant: bool = True) -> list[Any]:
    """Return the names for pytest.mark.parametrize; those beyond a spread are slow."""
    names = [name for name in sorted(robot_folders()) if redundant or name not in REDUNDANT]
    return [name if name in OFTEN else pytest.param(name, marks=pytest.mark.slow) for name in names]
