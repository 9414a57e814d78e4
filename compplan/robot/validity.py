"""visited.toml: where a campaign was, and how well the parts of a robot folder that are in doubt held there.

    schema = 1

    [[part]]                           # what the folder holds of an error in doubt, as effects.toml writes it
    effect = "link_geometry"
    joint  = "joint_3"
    axis   = "tx"
    keys   = ["tx_m"]
    value  = [1.2e-4]                  # SI

    [stays]                            # poses at which the parts were judged by fits that never saw them
    joints    = [[0.1, -0.4, ...]]     # rad or m
    wrench    = [[0, 0, -100, 0, 0, 0]]  # N, N m, base axes, at the TCP
    share     = [0.97]                 # part of their motion of the tip that was there
    deviation = [0.10]                 # one standard deviation of it
    spread    = 0.2                    # standard deviation of that part from place to place, beyond noise (0)

A folder without the file holds no part in doubt. A key "name#i" is item i of the list "name"; `fixed` holds settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import Field

from compplan.errors import InputError
from compplan.io.tomlfile import Numbers, SchemaOne, StrictTable, Words, read_toml_model

Array = NDArray[np.float64]

FILE = "visited.toml"
#: Effects that go with the tool: another one on the flange has its own.
OF_TOOL = ("tool_frame", "payload")


@dataclass(frozen=True, eq=False)
class ValidityPart:
    """An error in doubt that a folder holds.

    Attributes:
        effect: Name of the effect.
        joint: Its joint, or None.
        axis: Its axis, or None.
        keys: Parameters; "name#i" is item i of the list "name". Length k.
        value: What the folder holds of each. Shape (k,). [SI]
        fixed: Settings of the effect.
    """

    effect: str
    joint: str | None
    axis: str | None
    keys: tuple[str, ...]
    value: Array
    fixed: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ValidityRegion:
    """Where a campaign was, k stays, and how well the parts in doubt held there.

    Attributes:
        parts: The parts.
        q: Joint positions. Shape (k, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (k, 6). [N, N m]
        share: Part of their motion of the tip that was there. Shape (k,).
        deviation: Standard deviation of it. Shape (k,).
        spread: Standard deviation of that part from one place to another, the noise of the measurement taken off.
    """

    parts: tuple[ValidityPart, ...]
    q: Array
    wrench: Array
    share: Array
    deviation: Array
    spread: float = 0.0

    def of_arm(self, joints: set[str]) -> ValidityRegion:
        """Return it without the parts that go with the tool, or sit at none of these joints."""
        kept = (p for p in self.parts if p.effect not in OF_TOOL and (p.joint is None or p.joint in joints))
        return replace(self, parts=tuple(kept))


class ValidityPartTable(StrictTable):
    """[[part]]: what the folder holds of one effect."""

    effect: str = Field(min_length=1)
    joint: str | None = None
    axis: str | None = None
    keys: Annotated[Words, Field(min_length=1)]
    value: Numbers
    fixed: dict[str, Any] = Field(default_factory=dict)


class PosesTable(StrictTable):
    """[stays]: where the parts were judged."""

    joints: Annotated[tuple[Numbers, ...], Field(strict=False, min_length=1)]
    wrench: Annotated[tuple[Numbers, ...], Field(strict=False, min_length=1)]
    share: Numbers
    deviation: Annotated[tuple[Annotated[float, Field(gt=0.0)], ...], Field(strict=False)]
    spread: Annotated[float, Field(ge=0.0)] = 0.0


class ValidityTable(StrictTable):
    """visited.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    part: Annotated[tuple[ValidityPartTable, ...], Field(strict=False)] = ()
    stays: PosesTable


def read_visited(file: Path, nq: int) -> ValidityRegion | None:
    """Read visited.toml of a robot of nq joints; None where there is no such file.

    Raises:
        InputError: With file and key, if it is not what it has to be.
    """
    if not file.exists():
        return None
    table = read_toml_model(ValidityTable, file)
    stays = table.stays
    k = len(stays.joints)
    for name, width in (("joints", nq), ("wrench", 6)):
        rows = getattr(stays, name)
        if len(rows) != k or any(len(row) != width for row in rows):
            raise InputError(f"expected {k} rows of {width} numbers", file=file, where=f"stays.{name}")
    for name in ("share", "deviation"):
        if len(getattr(stays, name)) != k:
            raise InputError(f"has {len(getattr(stays, name))} numbers, expected {k}", file=file, where=f"stays.{name}")
    for number, part in enumerate(table.part):
        if len(part.value) != len(part.keys):
            message = f"has {len(part.value)} numbers, expected {len(part.keys)}, one a key"
            raise InputError(message, file=file, where=f"part[{number}].value")
    parts = tuple(
        ValidityPart(p.effect, p.joint, p.axis, p.keys, np.array(p.value, float), dict(p.fixed)) for p in table.part
    )
    return ValidityRegion(
        parts, np.array(stays.joints), np.array(stays.wrench), np.array(stays.share), np.array(stays.deviation),
        stays.spread,
    )  # fmt: skip


def format_visited(visited: ValidityRegion) -> str:
    """Return the text of visited.toml; poses and shares have six digits, values all of them."""
    parts = []
    for part in visited.parts:
        place = {"effect": part.effect, "joint": part.joint, "axis": part.axis}
        table = {key: text for key, text in place.items() if text is not None}
        fixed = {"fixed": dict(part.fixed)} if part.fixed else {}
        parts.append({**table, "keys": list(part.keys), "value": part.value.tolist(), **fixed})
    lines = [tomli_w.dumps({"schema": 1, "part": parts}), "[stays]"]
    for name, values in (("joints", visited.q), ("wrench", visited.wrench)):
        rows = (f"    [{', '.join(_short(v) for v in row)}]," for row in values.tolist())
        lines += [f"{name} = [", *rows, "]"]
    for name, values in (("share", visited.share), ("deviation", visited.deviation)):
        lines.append(f"{name} = [{', '.join(_short(v) for v in values.tolist())}]")
    lines.append(f"spread = {_short(visited.spread)}")
    return "\n".join(lines) + "\n"


def _short(value: float) -> str:
    return repr(float(f"{value:.6g}"))
