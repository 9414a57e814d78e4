"""Reproduction of papers: published and computed values, with the assumptions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.reproduce.paper import Reproduction
from compplan.robot import Robot, load_robot

#: All papers, by module name; each has `reproduce(load) -> Reproduction`.
PAPERS: Registry[Any] = Registry(("mamedov2018", "klimchik2018", "johra2022", "dumas2011", "singh2021"), __name__)


def reproduce_paper(name: str, load: Callable[[str], Robot] = load_robot) -> Reproduction:
    """Compute all results of a paper that can be reproduced.

    Args:
        name: Name of the paper, a key of `PAPERS`.
        load: Function that loads a robot by name.

    Raises:
        UnknownNameError: If the paper is not in `PAPERS`.
    """
    if name not in PAPERS:
        raise UnknownNameError("paper", name, list(PAPERS))
    result: Reproduction = PAPERS[name].reproduce(load)
    return result
