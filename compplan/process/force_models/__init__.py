"""Force models, one file each: numbers of a process, and the wrench on the tool that follows from them along a path.

Each file holds what the model is called in `words`, and its `table`: the keys of a job's [process] with their ranges,
`model` being the name of the file. Tables differ in what the wrench
follows from:

    PathForceTable     `wrench_along(nominal)`, path axes: from path and feed alone      compplan.toolpath.contact
    CuttingTable       `cutter`, `spindle`, `shape`: from what a cutter meets of stock    compplan.process.cutting

A new model is one new file and one line here.
"""

from __future__ import annotations

from typing import Protocol

from compplan.io.registry import Registry
from compplan.toolpath.contact import ForceTable


class ForceModel(Protocol):
    """What the file of a force model offers; `words` say in a few words what it is, in help and on pages."""

    words: str
    table: type[ForceTable]


#: Every force model, by the name of its file.
FORCE_MODELS: Registry[ForceModel] = Registry[ForceModel]((
    "columns",
    "constant",
    "milling",
    "end_mill",
    "drill",
    "isf",
    "isf_regression",
    "friction_stir",
    "grinding",
    "file",
), __name__)  # fmt: skip


def name_force_model(name: str) -> str:
    """Name a force model as pages do: in its words, and as a job does."""
    return f"{FORCE_MODELS[name].words} ({name})"
