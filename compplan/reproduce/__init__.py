"""Papers reproduced: their figures beside ours, with what had to be assumed."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from compplan.errors import UnknownNameError
from compplan.reproduce.paper import Reproduction
from compplan.robot import Robot, load_robot

PAPERS = {
    "mamedov2018": "compplan.reproduce.mamedov2018",
    "klimchik2018": "compplan.reproduce.klimchik2018",
    "johra2022": "compplan.reproduce.johra2022",
    "dumas2011": "compplan.reproduce.dumas2011",
    "singh2021": "compplan.reproduce.singh2021",
}


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
    module = importlib.import_module(PAPERS[name])
    result: Reproduction = module.reproduce(load)
    return result
