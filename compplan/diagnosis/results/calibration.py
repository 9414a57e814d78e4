"""Calibration: what a controller takes from a diagnosis - zeros, lengths, tool and base, with their intervals.

Values are those of the robot folder that is delivered; intervals hold 95 %, from the posterior of its parameters. What
a campaign cannot tell apart is shared out by the size that small errors have in this robot, and has wide intervals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.controllers.writers.frames import euler_angles, flange_turn
from compplan.diagnosis.data.shared import HALF_WIDTH, NEGLIGIBLE
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.results.verdict import CLAIMED
from compplan.robot import Array
from compplan.robot.mounting import mounted_tool

if TYPE_CHECKING:
    from compplan.diagnosis.results.delivery import Delivery
    from compplan.diagnosis.results.result import Diagnosis


#: Effects that a controller's tables can hold.
ZEROS, LENGTHS, FRAMES = "joint_offset", "link_geometry", ("tool_frame", "base_frame")
#: Unit of a table and its factor, by the unit of a parameter (theory).
SHOWN = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / np.pi)}


@dataclass(frozen=True)
class Correction:
    """One number to enter, with its 95 % interval.

    Attributes:
        effect: "joint_offset", "link_geometry", "tool_frame" or "base_frame".
        joint: Its joint, or None.
        axis: Its axis, or None: of the parent link for a length, of its own frame for tool and base.
        value: Change against the nominal robot. [`unit`]
        low: Lower end. [`unit`]
        high: Upper end. [`unit`]
        unit: "mm" or "deg".
        named: Whether the verdict names it as a cause.
    """

    effect: str
    joint: str | None
    axis: str | None
    value: float
    low: float
    high: float
    unit: str
    named: bool

    @property
    def plain(self) -> bool:
        """Tell whether its interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0

    def to_json(self) -> dict[str, Any]:
        """Return the correction as diagnosis.json holds it."""
        numbers = {f"{key}_{self.unit}": round(getattr(self, key), 6) for key in ("value", "low", "high")}
        return {"effect": self.effect, "joint": self.joint, "axis": self.axis, **numbers, "named": self.named}


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame as controllers take it, with 95 % half widths where the campaign tells them.

    Attributes:
        name: "tool" (TCP in the controller's flange frame), "base" (robot base in the measurement frame),
            "target LABEL" (in the TCP frame).
        position: Shape (3,). [mm]
        angles: A, B, C: turns about z, the new y and the new x; None where positions do not tell them. Shape (3,).
            [deg]
        half_position: Half widths along the frame's own axes, or None. Shape (3,). [mm]
        half_angles: Half widths about the frame's own axes, or None. Shape (3,). [deg]
    """

    name: str
    position: Array
    angles: Array | None
    half_position: Array | None
    half_angles: Array | None

    def to_json(self) -> dict[str, Any]:
        """Return the frame as diagnosis.json holds it."""
        table: dict[str, Any] = {
            "name": self.name,
            **{f"{key}_mm": round(float(v), 5) for key, v in zip("xyz", self.position, strict=True)},
        }
        if self.angles is not None:
            table |= {f"{key}_deg": round(float(v), 6) for key, v in zip("abc", self.angles, strict=True)}
        if self.half_position is not None:
            table["half_width_mm"] = [round(float(v), 5) for v in self.half_position]
        if self.half_angles is not None:
            table["half_width_deg"] = [round(float(v), 6) for v in self.half_angles]
        return table


def list_corrections(diagnosis: Diagnosis) -> tuple[Correction, ...]:
    """List zeros, lengths and frames of the delivered robot, as changes against the nominal one."""
    delivery = diagnosis.deliveries[0]
    if delivery.fitted is None:
        return ()
    equations = delivery.fitted.search.equations
    spreads = _spreads(delivery)
    named = {f.effect.place[:2] for f in diagnosis.verdict.findings if f.probability >= CLAIMED}
    found: dict[str, Correction] = {}
    for number, signature in enumerate(equations.signatures):
        if signature.name not in (ZEROS, LENGTHS, *FRAMES):
            continue
        for column, key in zip(equations.columns(number), signature.keys, strict=True):
            name = equations.names[column]
            if name in found or name not in spreads:
                continue
            kind, _, unit = key.rpartition("_")
            shown, factor = SHOWN[unit]
            value, half = factor * delivery.state.values.get(name, 0.0), factor * HALF_WIDTH * spreads[name]
            axis = None if signature.name == ZEROS else kind
            found[name] = Correction(
                signature.name, signature.joint, axis, value, value - half, value + half, shown,
                (signature.name, signature.joint) in named,
            )  # fmt: skip
    order = [ZEROS, LENGTHS, *FRAMES]
    return tuple(sorted(found.values(), key=lambda c: order.index(c.effect)))


def list_frames(diagnosis: Diagnosis) -> tuple[Pose, ...]:
    """List the tool of the delivered robot, and frames that were registered."""
    delivery = diagnosis.deliveries[0]
    spreads = _spreads(delivery)
    robot = diagnosis.updated
    tool = np.linalg.inv(flange_turn(robot)) @ mounted_tool(robot)
    frames = [_pose("tool", tool, _halves(delivery, "tool_frame", None, spreads))]
    registration = delivery.state.registration
    if registration is not None and registration.parts:
        if "base" in registration.parts:
            frames.append(_pose("base", registration.base, _halves(delivery, REGISTRATION, "base", spreads)))
        if "tool" in registration.parts:
            for number, label in enumerate(registration.targets):
                half = _halves(delivery, REGISTRATION, f"tool {number}", spreads)
                pose = _pose(f"target {label}".rstrip(), registration.tool[number], half)
                frames.append(pose if half[1] is not None else replace(pose, angles=None))
    return tuple(frames)


def _pose(name: str, matrix: Array, halves: tuple[Array | None, Array | None]) -> Pose:
    return Pose(name, 1e3 * matrix[:3, 3], euler_angles(matrix[None, :3, :3], "ZYX")[0], *halves)


def _spreads(delivery: Delivery) -> dict[str, float]:
    """Return the standard deviation of every parameter that the campaign tells, by column. [SI]"""
    if delivery.fitted is None:
        return {}
    fitted = delivery.fitted
    equations, posterior = fitted.search.equations, fitted.model.posterior
    prior = fitted.search.prior_of(fitted.model.claims)
    size = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    free = prior.free[posterior.columns]
    told = ~free | (size < NEGLIGIBLE * np.sqrt(prior.variance(posterior.hyper.log_tau)[posterior.columns]))
    size = size * equations.scale[posterior.columns]
    return {equations.names[c]: float(s) for c, s, t in zip(posterior.columns, size, told, strict=True) if t}


def _halves(
    delivery: Delivery, name: str, form: str | None, spreads: dict[str, float]
) -> tuple[Array | None, Array | None]:
    """Return half widths of a frame's position [mm] and turns [deg], None where the campaign does not tell them."""
    if delivery.fitted is None:
        return None, None
    equations = delivery.fitted.search.equations
    own: dict[str, float] = {}
    for number, signature in enumerate(equations.signatures):
        if signature.name == name and form in (None, signature.form):
            for column, key in zip(equations.columns(number), signature.keys, strict=True):
                if equations.names[column] in spreads:
                    own[key] = HALF_WIDTH * spreads[equations.names[column]]
    position = [own.get(f"t{axis}_m", np.nan) for axis in "xyz"]
    angles = [own.get(f"r{axis}_rad", np.nan) for axis in "xyz"]
    moved = 1e3 * np.array(position) if np.isfinite(position).all() else None
    turned = np.rad2deg(angles) if np.isfinite(angles).all() else None
    return moved, turned
