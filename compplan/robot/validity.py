"""visited.toml: poses of a campaign, and how well the uncertain parts of a robot folder held there.

    schema = 1

    [[part]]                           # an uncertain part of the folder, as in effects.toml
    effect = "link_geometry"
    joint  = "joint_3"
    axis   = "tx"
    keys   = ["tx_m"]
    value  = [1.2e-4]                  # SI

    [stays]                            # poses left out of the fits that the parts were validated at
    joints    = [[0.1, -0.4, ...]]     # rad or m
    wrench    = [[0, 0, -100, 0, 0, 0]]  # N, N m, base axes, at the TCP
    share     = [0.97]                 # observed share of their tip motion
    deviation = [0.10]                 # one standard deviation of it
    spread    = 0.2                    # standard deviation of the share between poses, without noise

A folder without the file has no uncertain parts. A key "name#i" is item i of the list "name"; `fixed` holds settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from pydantic import Field

from compplan.errors import InputError
from compplan.io.tomlfile import Numbers, SchemaOne, StrictTable, Words, read_toml_model
from compplan.robot.uncertainty import Array, EffectPlaceTable, short

FILE = "visited.toml"
#: Effects that belong to the tool.
OF_TOOL = ("tool_frame", "payload")


@dataclass(frozen=True, eq=False)
class ValidityPart:
    """An uncertain part of a folder."""

    effect: str  #: Name of the effect.
    joint: str | None  #: Its joint, or None.
    axis: str | None  #: Its axis, or None.
    keys: tuple[str, ...]  #: Parameters; "name#i" is item i of the list "name". Length k.
    value: Array  #: Values in the folder. Shape (k,). [SI]
    fixed: Mapping[str, Any] = field(default_factory=dict)  #: Settings of the effect.


@dataclass(frozen=True, eq=False)
class ValidityRegion:
    """Poses of a campaign and the validation of uncertain parts at k of them."""

    parts: tuple[ValidityPart, ...]  #: The parts.
    q: Array  #: Joint positions. Shape (k, nq). [rad or m]
    wrench: Array  #: Wrench of the environment on the tool at the TCP, base axes. Shape (k, 6). [N, N m]
    share: Array  #: Observed share of the tip motion of the parts. Shape (k,).
    deviation: Array  #: Standard deviation of it. Shape (k,).
    spread: float = 0.0  #: Standard deviation of the share between poses, without measurement noise.

    def of_arm(self, joints: set[str]) -> ValidityRegion:
        """Remove the parts that belong to the tool or to other joints."""
        kept = (p for p in self.parts if p.effect not in OF_TOOL and (p.joint is None or p.joint in joints))
        return replace(self, parts=tuple(kept))


class ValidityPartTable(EffectPlaceTable):
    """[[part]]: an uncertain part."""

    keys: Annotated[Words, Field(min_length=1)]
    value: Numbers


class PosesTable(StrictTable):
    """[stays]: poses of the validation."""

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
    """Read visited.toml of a robot of nq joints, or return None without the file.

    Raises:
        InputError: With file and key, if it is invalid.
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
    """Return the text of visited.toml; poses and shares with six digits."""
    parts = []
    for part in visited.parts:
        place = {"effect": part.effect, "joint": part.joint, "axis": part.axis}
        table = {key: text for key, text in place.items() if text is not None}
        fixed = {"fixed": dict(part.fixed)} if part.fixed else {}
        parts.append({**table, "keys": list(part.keys), "value": part.value.tolist(), **fixed})
    lines = [tomli_w.dumps({"schema": 1, "part": parts}), "[stays]"]
    for name, values in (("joints", visited.q), ("wrench", visited.wrench)):
        rows = (f"    [{', '.join(repr(short(v)) for v in row)}]," for row in values.tolist())
        lines += [f"{name} = [", *rows, "]"]
    for name, values in (("share", visited.share), ("deviation", visited.deviation)):
        lines.append(f"{name} = [{', '.join(repr(short(v)) for v in values.tolist())}]")
    lines.append(f"spread = {short(visited.spread)}")
    return "\n".join(lines) + "\n"
