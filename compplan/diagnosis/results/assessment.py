"""Assessment: corrections to enter into a controller, and pose accuracy, for calibration engineers.

Values are those of the delivered robot folder; their 95 % intervals come from the posterior of its parameters.
Parameters that a campaign cannot separate share an error by their prior sizes, and have wide intervals. The pose
accuracy of ISO 9283 is the distance between a commanded pose and the mean of the attained poses [ISO9283]. A pose is a
stay (repeated poses count separately), or a block of a path; `after` is predicted by models fitted without it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.frames import euler_angles, flange_turn
from compplan.diagnosis.data.channels import block_index
from compplan.diagnosis.data.shared import FEW_ROWS, HALF_WIDTH, NEGLIGIBLE
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import EVIDENCE
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.results.delivery import NOMINAL
from compplan.diagnosis.results.verdict import CLAIMED
from compplan.robot import Array
from compplan.robot.mounting import mounted_tool

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis

#: Effects that a controller's tables can hold.
ENTERED = ("joint_offset", "link_geometry", "tool_frame", "base_frame")
#: Unit of a table and its factor, by the unit of a parameter (theory).
SHOWN = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / np.pi)}


@dataclass(frozen=True)
class Correction:
    """One number to enter: change against the nominal robot with its 95 % interval, in `unit`, "mm" or "deg".

    `effect` is one of `ENTERED`; `axis` is that of the parent link for a length, of the frame itself for tool and base,
    None for a zero; `named`: whether the verdict names the effect as a cause.
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
        """Whether its interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0

    def to_json(self) -> dict[str, Any]:
        """Return the correction in the format of diagnosis.json."""
        numbers = {f"{key}_{self.unit}": round(getattr(self, key), 6) for key in ("value", "low", "high")}
        return {"effect": self.effect, "joint": self.joint, "axis": self.axis, **numbers, "named": self.named}


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in a controller's convention, with 95 % half widths if the campaign determines them."""

    #: "tool" (TCP in the controller's flange frame), "base" (robot base in the measurement frame), "target LABEL" (in
    #: the TCP frame).
    name: str
    position: Array  #: Shape (3,). [mm]
    #: A, B, C: turns about z, the new y and the new x; None if positions do not determine them. [deg]
    angles: Array | None
    half_position: Array | None  #: Half widths along the axes of the frame, or None. Shape (3,). [mm]
    half_angles: Array | None  #: Half widths about the axes of the frame, or None. Shape (3,). [deg]

    def to_json(self) -> dict[str, Any]:
        """Return the frame in the format of diagnosis.json."""
        table: dict[str, Any] = {"name": self.name}
        table |= {f"{key}_mm": round(float(v), 5) for key, v in zip("xyz", self.position, strict=True)}
        if self.angles is not None:
            table |= {f"{key}_deg": round(float(v), 6) for key, v in zip("abc", self.angles, strict=True)}
        if self.half_position is not None:
            table["half_width_mm"] = [round(float(v), 5) for v in self.half_position]
        if self.half_angles is not None:
            table["half_width_deg"] = [round(float(v), 6) for v in self.half_angles]
        return table


@dataclass(frozen=True)
class Accuracy:
    """Distances over a number of poses: mean, largest, mean plus three standard deviations, root mean square. [mm]"""

    poses: int
    mean_mm: float
    max_mm: float
    mean_and_3_sigma_mm: float
    rms_mm: float


@dataclass(frozen=True, eq=False)
class Assessment:
    """Figures of a diagnosis for a calibration engineer."""

    corrections: tuple[Correction, ...]  #: Zeros, lengths, tool and base to enter, with intervals.
    frames: tuple[Pose, ...]  #: Tool and registered frames in a controller's convention.
    accuracy: dict[str, Accuracy]  #: Pose accuracy "before" and, held out, "after".
    worst: list[dict[str, Any]]  #: Poses that the delivered model predicts worst: row, joints_deg_or_mm, held_out_mm.

    def to_json(self) -> dict[str, Any]:
        """Return the content of `for_controllers` and `accuracy` in diagnosis.json."""
        figures = {name: {k: round(v, 5) for k, v in asdict(one).items()} for name, one in self.accuracy.items()}
        return {
            "for_controllers": {
                "corrections": [correction.to_json() for correction in self.corrections],
                "frames": [frame.to_json() for frame in self.frames],
            },
            "accuracy": {**figures, "worst_poses": self.worst},
        }


def assess_diagnosis(diagnosis: Diagnosis) -> Assessment:
    """Compute the assessment of the delivered robot of a diagnosis."""
    spreads = _spreads(diagnosis)
    before, after, first = _stays(diagnosis)
    accuracy = {"before": _summarise(before), "after": _summarise(after)}
    unit = np.where(diagnosis.robot.prismatic, 1e3, 180.0 / np.pi)
    worst = []
    for k in np.argsort(-after, kind="stable")[:FEW_ROWS]:
        joints = (diagnosis.fit.problem.campaign.q[first[k]] * unit).round(4).tolist()
        worst.append({"row": int(first[k]), "joints_deg_or_mm": joints, "held_out_mm": round(1e3 * float(after[k]), 5)})
    return Assessment(list_corrections(diagnosis, spreads), list_frames(diagnosis, spreads), accuracy, worst)


def _stays(diagnosis: Diagnosis) -> tuple[Array, Array, NDArray[np.int_]]:
    """Average stays: distances before and after, first row of each. Shape (stays,). [m]"""
    campaign, held = diagnosis.fit.problem.campaign, diagnosis.delivery.held
    good = campaign.usable.copy()
    good[diagnosis.outliers] = False
    keep = good[held.rows]
    rows = held.rows[keep]
    _, first, stay = np.unique(block_index(campaign)[rows], return_index=True, return_inverse=True)
    count = np.bincount(stay)
    sides = []
    for residual in (diagnosis.residual_before[rows], held.residual[keep]):
        mean = np.column_stack([np.bincount(stay, residual[:, k]) for k in range(3)]) / count[:, None]
        sides.append(np.linalg.norm(mean, axis=1))
    return sides[0], sides[1], rows[first]


def _summarise(distance: Array) -> Accuracy:
    mean = float(distance.mean())
    spread = float(distance.std(ddof=1)) if len(distance) > 1 else 0.0
    rms = float(np.sqrt(np.mean(distance**2)))
    return Accuracy(len(distance), *(1e3 * v for v in (mean, float(distance.max()), mean + 3.0 * spread, rms)))


def list_corrections(diagnosis: Diagnosis, spreads: dict[str, float]) -> tuple[Correction, ...]:
    """List zeros, lengths and frames of the delivered robot; `spreads`: deviation of each parameter by column. [SI]"""
    delivery = diagnosis.delivery
    if delivery.kind == NOMINAL:
        return ()
    equations = diagnosis.equations
    named = {f.effect.place[:2] for f in diagnosis.verdict.findings if f.probability >= CLAIMED}
    found: dict[str, Correction] = {}
    for number, signature in enumerate(equations.signatures):
        if signature.name not in ENTERED:
            continue
        for column, key in zip(equations.columns(number), signature.keys, strict=True):
            name = equations.names[column]
            if name in found or name not in spreads:
                continue
            kind, _, unit = key.rpartition("_")
            shown, factor = SHOWN[unit]
            value, half = factor * delivery.state.values.get(name, 0.0), factor * HALF_WIDTH * spreads[name]
            axis = None if signature.name == "joint_offset" else kind
            found[name] = Correction(
                signature.name, signature.joint, axis, value, value - half, value + half, shown,
                (signature.name, signature.joint) in named,
            )  # fmt: skip
    return tuple(sorted(found.values(), key=lambda c: ENTERED.index(c.effect)))


def list_frames(diagnosis: Diagnosis, spreads: dict[str, float]) -> tuple[Pose, ...]:
    """List the tool of the delivered robot, and frames that were registered; `spreads` as in `list_corrections`."""
    robot, registration = diagnosis.updated, diagnosis.registration

    def show(name: str, matrix: Array, effect: str, form: str | None) -> Pose:
        angles = euler_angles(matrix[None, :3, :3], "ZYX")[0]
        return Pose(name, 1e3 * matrix[:3, 3], angles, *_halves(diagnosis.equations, effect, form, spreads))

    tool = np.linalg.inv(flange_turn(robot)) @ mounted_tool(robot)
    frames = [show("tool", tool, "tool_frame", None)]
    if registration is not None and "base" in registration.parts:
        frames.append(show("base", registration.base, REGISTRATION, "base"))
    if registration is not None and "tool" in registration.parts:
        for number, label in enumerate(registration.targets):
            pose = show(f"target {label}".rstrip(), registration.tool[number], REGISTRATION, f"tool {number}")
            frames.append(pose if pose.half_angles is not None else replace(pose, angles=None))
    return tuple(frames)


def _spreads(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the standard deviation of every parameter that the campaign determines, by column. [SI]"""
    equations, posterior = diagnosis.equations, diagnosis.delivery.posterior
    if diagnosis.delivery.kind == NOMINAL:
        return {}
    size = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    free = np.isin(posterior.columns, equations.columns_named(REGISTRATION))
    determined = ~free | (size < NEGLIGIBLE * np.sqrt(EVIDENCE.free_variance))
    size = size * equations.scale[posterior.columns]
    return {equations.names[c]: float(s) for c, s, d in zip(posterior.columns, size, determined, strict=True) if d}


def _halves(
    equations: NormalEquations, name: str, form: str | None, spreads: dict[str, float]
) -> tuple[Array | None, Array | None]:
    """Return half widths of a frame's position [mm] and turns [deg], None if the campaign does not determine them."""
    halves: dict[str, float] = {}
    for number, signature in enumerate(equations.signatures):
        if signature.name == name and form in (None, signature.form):
            for column, key in zip(equations.columns(number), signature.keys, strict=True):
                halves[key] = HALF_WIDTH * spreads.get(equations.names[column], np.nan)
    position = 1e3 * np.array([halves.get(f"t{axis}_m", np.nan) for axis in "xyz"])
    angles = np.rad2deg([halves.get(f"r{axis}_rad", np.nan) for axis in "xyz"])
    return (position if np.isfinite(position).all() else None), (angles if np.isfinite(angles).all() else None)
