"""Robot folders that a parametrised test runs over: the first eight and one of every further make; others are slow."""

from __future__ import annotations

from typing import Any

import pytest

from compplan.robot import robot_folders

#: One arm of every make (of KUKA: one whose zero pose is level and whose masses are published).
ONE_OF_EACH = {
    "abb_irb6640_185_280", "comau_nj220", "doosan_m1013", "fanuc_r1000ia80f", "franka_fr3", "kawasaki_rs080n",
    "kuka_kr210_r2700_2", "staubli_tx2_90", "ur10e", "yaskawa_gp25",
}  # fmt: skip
FIRST = {
    "fanuc_m10ia", "kuka_kr120_r3900", "kuka_kr240", "kuka_kr240_rail", "kuka_kr270", "kuka_kr270_full",
    "staubli_tx200", "ur10",
}  # fmt: skip
#: Seven joints turn: no branches to list, no words that tell them apart.
REDUNDANT = {"franka_fr3"}


def over_robots(*, redundant: bool = True) -> list[Any]:
    """Return the names for pytest.mark.parametrize; those beyond one of each make are marked slow."""
    often = FIRST | ONE_OF_EACH
    names = [name for name in sorted(robot_folders()) if redundant or name not in REDUNDANT]
    return [name if name in often else pytest.param(name, marks=pytest.mark.slow) for name in names]
