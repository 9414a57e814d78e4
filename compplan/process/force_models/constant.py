"""Force model with one constant wrench along the path."""

from __future__ import annotations

from typing import Literal

from compplan.io.tomlfile import Vector3
from compplan.toolpath.contact import ContactTable, Frame

words = "constant wrench"


class ConstantProcess(ContactTable):
    """The same wrench along the path; `during_rapid` keeps it in rapid moves too (a dead weight)."""

    model: Literal["constant"]
    force_N: Vector3
    moment_Nm: Vector3 = (0.0, 0.0, 0.0)
    frame: Frame = "part"
    during_rapid: bool = False


table = ConstantProcess
