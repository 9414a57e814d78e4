"""Force models, one module each: parameters of a process, and the resulting wrench on the tool along a path.

Each module holds a short description, `words`, and its `table`: the keys of a job's [process] with their ranges, where
`model` is the name of the module. Base classes of sections differ in the inputs of the wrench:

    PathForceTable     `wrench_along(nominal)`, path axes: only path and feed             compplan.toolpath.contact
    CuttingTable       `cutter`, `shape`: engagement of the cutter in the stock           compplan.process.cutting

A new model is one new module and one line here.
"""

from __future__ import annotations

from typing import Protocol

from compplan.io.registry import Registry
from compplan.toolpath.contact import ForceTable


class ForceModel(Protocol):
    """Interface of a force model's module; `words` is its short description in help and on pages."""

    words: str
    table: type[ForceTable]


#: Every force model, by the name of its module.
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
    """Return the name of a force model for pages: its description, and its name in a job."""
    return f"{FORCE_MODELS[name].words} ({name})"
