"""Papers reproduced: their figures beside ours, with what had to be assumed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.reproduce.paper import Reproduction
from compplan.robot import Robot, load_robot


class Paper(Protocol):
    """What the file of a paper offers."""

    def reproduce(self, load: Callable[[str], Robot]) -> Reproduction:
        """Compute everything of the paper that can be computed."""
        ...


#: Every paper, by the name of its file.
PAPERS: Registry[Paper] = Registry(("mamedov2018", "klimchik2018", "johra2022", "dumas2011", "singh2021"), __name__)


def reproduce_paper(name: str, load: Callable[[str], Robot] = load_robot) -> Reproduction:
    """Compute everything of a paper that can be computed.

    Args:
        name: Name of the paper, a key of `PAPERS`.
        load: Where the robots come from, by name.

    Raises:
        UnknownNameError: If the paper is not among them.
    """
    if name not in PAPERS:
        raise UnknownNameError("paper", name, list(PAPERS))
    return PAPERS[name].reproduce(load)
