"""Accuracy: what a pose is worth before and after, where it is worst, and what more poses would bring.

The pose accuracy of ISO 9283 is the distance between where a pose was commanded and the mean of where it was attained
[ISO9283]. Here a pose is a stay (rows of one stay averaged, poses met again count on their own), a path counts block by
block, and `after` is the delivered model's held-out prediction: poses that its parameters never saw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compplan.controllers.writers.frames import euler_angles, flange_turn
from compplan.diagnosis.data.channels import block_index
from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, HALF_WIDTH, NEGLIGIBLE, SEED
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_channels, posterior_mean
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.results.verdict import CLAIMED
from compplan.diagnosis.validation.held_out import free_of_frames
from compplan.robot import Array
from compplan.robot.mounting import mounted_tool

if TYPE_CHECKING:
    from compplan.diagnosis.results.delivery import Delivery
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.search.state import Fit

#: How many more poses the curve is asked for, and from how many on it is drawn (assumed: no further ahead than it has
#: seen).
MORE = 10


@dataclass(frozen=True)
class Accuracy:
    """Distances over a number of poses: mean, largest, mean plus three standard deviations, root mean square. [m]"""

    mean: float
    largest: float
    three_sigma: float
    rms: float
    poses: int

    def to_json(self) -> dict[str, float | int]:
        """Return the figures as diagnosis.json holds them."""
        names = {"mean": "mean", "max": "largest", "mean_and_3_sigma": "three_sigma", "rms": "rms"}
        figures = {f"{key}_mm": round(1e3 * getattr(self, name), 5) for key, name in names.items()}
        return {"poses": self.poses, **figures}


@dataclass(frozen=True)
class Learning:
    """Held-out error over the number of poses: e^2 = floor^2 + gain^2 / poses.

    Attributes:
        poses: Groups of poses that were fitted to, point by point.
        errors: Rms held-out distance of each. [m]
        floor: What no number of poses takes away. [m]
        gain: Error that one pose would leave beyond it. [m]
        now: Groups of poses of the campaign.
    """

    poses: tuple[float, ...]
    errors: tuple[float, ...]
    floor: float
    gain: float
    now: int

    def at(self, poses: float) -> float:
        """Return the error that the curve expects of a number of poses. [m]"""
        return float(np.sqrt(self.floor**2 + self.gain**2 / poses))

    def to_json(self) -> dict[str, Any]:
        """Return the curve as diagnosis.json holds it."""
        return {
            "poses": [round(p, 1) for p in self.poses],
            "held_out_rms_mm": [round(1e3 * e, 5) for e in self.errors],
            "poses_now": self.now,
            "expected_now_mm": round(1e3 * self.at(self.now), 5),
            f"expected_with_{MORE}_more_mm": round(1e3 * self.at(self.now + MORE), 5),
            "expected_with_endless_poses_mm": round(1e3 * self.floor, 5),
        }


@dataclass(frozen=True, eq=False)
class WorstPose:
    """A pose that the delivered model predicts badly: first row, joints [deg or mm], distance held out [m]."""

    row: int
    joints: Array
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Return the pose as diagnosis.json holds it."""
        joints = [round(float(v), 4) for v in self.joints]
        return {"row": self.row, "joints_deg_or_mm": joints, "held_out_mm": round(1e3 * self.distance, 5)}


def measure_accuracy(diagnosis: Diagnosis) -> dict[str, Accuracy]:
    """Measure the pose accuracy before, and held out after."""
    before, after, _ = _stays(diagnosis)
    return {"before": _summarise(before), "after": _summarise(after)}


def list_worst(diagnosis: Diagnosis) -> tuple[WorstPose, ...]:
    """List the poses that the delivered model predicts worst, held out."""
    _, after, first = _stays(diagnosis)
    order = np.argsort(-after, kind="stable")[:FEW_ROWS]
    unit = np.where(diagnosis.robot.prismatic, 1e3, 180.0 / np.pi)
    q = diagnosis.fit.problem.campaign.q
    return tuple(WorstPose(int(first[k]), q[first[k]] * unit, float(after[k])) for k in order)


def _stays(diagnosis: Diagnosis) -> tuple[Array, Array, NDArray[np.int_]]:
    """Average stays: distances before and after, first row of each. Shape (stays,). [m]"""
    campaign, held = diagnosis.fit.problem.campaign, diagnosis.deliveries[0].held
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
    return Accuracy(mean, float(distance.max()), mean + 3.0 * spread, rms, len(distance))


def draw_learning(diagnosis: Diagnosis) -> Learning | None:
    """Fit the delivered model to drawn parts of the poses, and predict the others to first order.

    Names, noise and the sizes of small errors are those of the whole campaign. None where there are too few poses, or
    where nothing is delivered.
    """
    delivery = diagnosis.deliveries[0]
    campaign = diagnosis.fit.problem.campaign
    _, pose = np.unique(campaign.pose, return_inverse=True)
    label = np.where(campaign.on_path, pose.max(initial=0) + 1 + block_index(campaign), pose.reshape(-1))
    if delivery.fitted is None:
        return None
    # rows that are no part of the fit (not measured, outliers, an approach that nobody knows) tell nothing here
    usable, group = np.zeros(len(label), bool), np.full(len(label), -1)
    usable[delivery.fitted.search.equations.source[0].rows] = True
    group[usable] = np.unique(label[usable], return_inverse=True)[1].reshape(-1)
    groups = int(group.max(initial=-1)) + 1
    if groups < MORE:
        return None
    rng = np.random.default_rng(SEED)
    parts = min(groups, ENOUGH_ROWS)
    part = np.where(usable, (rng.permutation(groups) % parts)[group], -1)
    products = [_multiply_part(delivery.fitted, part == k) for k in range(parts)]
    frames, freed = _frames(delivery.fitted), free_of_frames(delivery.fitted, groups)
    poses, errors = [], []
    # from half of the parts to all but one, and from every part on
    for count in range(parts // 2, parts):
        squares = []
        for start in range(parts):
            given = (start + np.arange(count)) % parts
            squares.append(_predict_rest(delivery.fitted, frames, [products[k] for k in given], ~np.isin(part, given)))
        poses.append(count / parts * groups)
        errors.append(freed * float(np.sqrt(np.mean(squares))))
    design = np.column_stack([np.ones(len(poses)), 1.0 / np.array(poses)])
    weight = 1.0 / np.array(errors) ** 2
    floor2, gain2 = nnls(design * weight[:, None], np.array(errors) ** 2 * weight)[0]
    return Learning(tuple(poses), tuple(errors), float(np.sqrt(floor2)), float(np.sqrt(gain2)), groups)


def _multiply_part(fitted: Fit, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the whitened products of the active columns over some rows: gram, and with the observations."""
    posterior = fitted.model.posterior
    channels = select_rows(fitted.search.equations, rows, posterior.columns)
    gram, against, _, _ = combine_channels(channels, posterior.hyper)
    return gram, against


def _frames(fitted: Fit) -> Array:
    """Return what frames that every campaign brings can follow, whitened, orthonormal. Shape (3 r, k)."""
    equations = fitted.search.equations
    columns = equations.designs[0][..., equations.columns_named(REGISTRATION)]
    return np.asarray(np.linalg.qr(columns.reshape(equations.observed[0].size, columns.shape[-1]))[0])


def _predict_rest(fitted: Fit, frames: Array, given: Sequence[tuple[Array, Array]], rest: NDArray[np.bool_]) -> float:
    """Return the mean square distance that a model fitted to some products leaves of other rows. [m^2]"""
    equations, posterior = fitted.search.equations, fitted.model.posterior
    prior = fitted.search.prior_of(fitted.model.claims).variance(posterior.hyper.log_tau)[posterior.columns]
    gram, against = (sum((p[k] for p in given), np.zeros_like(given[0][k])) for k in range(2))
    mean = posterior_mean(gram, against, prior)
    source = equations.source[0]
    seen = rest[source.rows]
    left = equations.observed[0] - equations.designs[0][..., posterior.columns] @ mean
    left = left - (frames @ (frames.T @ left.ravel())).reshape(left.shape)
    return float(np.mean(np.sum((left[seen] * source.sigma[seen]) ** 2, axis=1)))


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a diagnosis is worth to a calibration engineer.

    Attributes:
        corrections: Zeros, lengths, tool and base to enter, with intervals.
        frames: Tool and registered frames as controllers take them.
        accuracy: Pose accuracy "before" and, held out, "after".
        learning: Held-out error over the number of poses, or None.
        worst: Poses that are predicted worst.
    """

    corrections: tuple[Correction, ...]
    frames: tuple[Pose, ...]
    accuracy: dict[str, Accuracy]
    learning: Learning | None
    worst: tuple[WorstPose, ...]

    def to_json(self) -> dict[str, Any]:
        """Return what diagnosis.json holds under `for_controllers` and `accuracy`."""
        return {
            "for_controllers": {
                "corrections": [correction.to_json() for correction in self.corrections],
                "frames": [frame.to_json() for frame in self.frames],
            },
            "accuracy": {
                **{name: accuracy.to_json() for name, accuracy in self.accuracy.items()},
                "learning": None if self.learning is None else self.learning.to_json(),
                "worst_poses": [pose.to_json() for pose in self.worst],
            },
        }


def assess_diagnosis(diagnosis: Diagnosis) -> Assessment:
    """Assess the delivered robot of a diagnosis."""
    return Assessment(
        list_corrections(diagnosis), list_frames(diagnosis), measure_accuracy(diagnosis), draw_learning(diagnosis),
        list_worst(diagnosis),
    )  # fmt: skip


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
