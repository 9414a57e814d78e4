"""Registration: frames that no robot folder can know - where the instrument stood, where the target sat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.files.tomlfile import SchemaOne, StrictTable, Vector3, read_toml_model
from compplan.measure.campaign import Campaign
from compplan.robot import Array

PARTS = ("base", "tool")
#: Greatest distance of a registered frame; degrees stay far below it. [mm]
FARTHEST_MM = 1e6
STEPS = 60
#: Rows that fix a frame at the least, and the extent of places that are one place. [m]
LEAST_ROWS, STANDING = 3, 1e-6
#: A step below this has converged [m or rad].
SETTLED = 1e-10
#: Radians of orientation that weigh as much as a metre of position.
ANGLE_WEIGHT = 0.5


@dataclass(frozen=True, eq=False)
class Registration:
    """Frames fitted to one campaign.

    Attributes:
        base: Pose of the robot base in the measurement frame. Shape (4, 4). [m]
        tool: Pose of each target in the TCP frame. Shape (targets, 4, 4). [m]
        targets: Label of each target.
        parts: Which of "base" and "tool" were fitted.

    """

    base: Array
    tool: Array
    targets: tuple[str, ...] = ("",)
    parts: tuple[str, ...] = PARTS

    @staticmethod
    def identity(campaign: Campaign, parts: Sequence[str] = PARTS) -> Registration:
        """Return the registration that changes nothing: the target is the TCP, or where the campaign says."""
        tools = np.repeat(np.eye(4)[None], len(campaign.target_names), axis=0)
        if campaign.target_offset is not None:
            tools[:, :3, 3] = campaign.target_offset
        return Registration(np.eye(4), tools, campaign.target_names, tuple(parts))


def stated_registration(campaign: Campaign) -> Registration | None:
    """Return the registration that a campaign states by its target offset, or None where there is nothing to state."""
    return None if campaign.target_offset is None else Registration.identity(campaign, ())


def _check_near(value: Vector3) -> Vector3:
    if max(map(abs, value)) > FARTHEST_MM:
        raise ValueError(f"is {list(value)}, at most {FARTHEST_MM:g}")
    return value


class RegistrationPose(StrictTable):
    """A pose of registration.toml: mm, and a rotation vector in degrees."""

    position_mm: Annotated[Vector3, AfterValidator(_check_near)]
    rotation_deg: Annotated[Vector3, AfterValidator(_check_near)]

    def pose(self) -> Array:
        """Return it as a matrix. Shape (4, 4) [m]."""
        pose = np.eye(4)
        pose[:3, 3] = np.array(self.position_mm) * 1e-3
        pose[:3, :3] = Rotation.from_rotvec(np.deg2rad(self.rotation_deg)).as_matrix()
        return pose


class TargetTable(RegistrationPose):
    """[[tool]]: a target in the TCP frame."""

    target: str = ""


class RegistrationTable(StrictTable):
    """registration.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    fitted: Annotated[tuple[Literal["base", "tool"], ...], Field(strict=False)]
    base: RegistrationPose
    tool: Annotated[tuple[TargetTable, ...], Field(strict=False, min_length=1)]


def parse_parts(text: str | None) -> tuple[str, ...]:
    """Read the value of --register: "base", "tool" or "base,tool".

    Raises:
        InputError: If it names anything else.

    """
    if text is None:
        return ()
    parts = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--register names {part!r}, choose from {list(PARTS)}, separated by a comma")
    return parts


def fit_registration(
    campaign: Campaign,
    position: Array,
    rotation: Array,
    parts: Sequence[str],
    *,
    rows: NDArray[np.bool_] | None = None,
) -> Registration:
    """Fit base and tool frames to a campaign, robustly; the robot's own poses stay as they are.

    Minimises the distance of T_world_base T_base_tcp T_tcp_target from the measured targets, orientation included where
    it was measured, by Gauss-Newton steps with Huber weights, started from the best rigid fit of the positions.

    Args:
        campaign: What was measured.
        position: TCP that the robot model predicts, base frame. Shape (n, 3). [m]
        rotation: Its orientation. Shape (n, 3, 3).
        parts: Which of "base" and "tool" to fit.
        rows: Rows to use; all usable ones if left out. Shape (n,), bool.

    Raises:
        InputError: If the rows cannot fix a frame: fewer than three, or the tool at one place in all of them.

    """
    use = campaign.usable if rows is None else np.asarray(rows, bool) & campaign.usable
    index = np.flatnonzero(use)
    registration = Registration.identity(campaign, parts)
    if not len(index) or not parts:
        return registration
    _check_rows(campaign, position[index], len(index), parts)
    measured, p, R = campaign.position[index], position[index], rotation[index]
    turned = None if campaign.rotation is None else campaign.rotation[index]
    tool_of = campaign.target_index[index]
    base, tools = np.eye(4), registration.tool.copy()
    if "base" in parts:
        base = _start_base(p, R, measured, turned)
    n_tools = len(tools) if "tool" in parts else 0
    for _ in range(STEPS):
        step = _step(p, R, measured, turned, tool_of, base, tools, "base" in parts, n_tools)
        if "base" in parts:
            base = _exp(step[:6]) @ base
        for k in range(n_tools):
            tools[k] = tools[k] @ _exp(step[6 + 6 * k : 12 + 6 * k])
        if np.abs(step).max(initial=0.0) < SETTLED:
            break
    return Registration(base, tools, campaign.target_names, tuple(parts))


def _check_rows(campaign: Campaign, position: Array, count: int, parts: Sequence[str]) -> None:
    """Refuse rows that leave frames open: too few of them, or none in which the tool or the target has moved."""
    words = f"--register {','.join(parts)}"
    if count < LEAST_ROWS:
        message = f"{words} needs at least {LEAST_ROWS} rows with joints and a measured position, the log has {count}"
        raise InputError(message, file=campaign.file)
    for what, points in (("joints", position), ("measured positions", campaign.position[campaign.usable])):
        if float(np.ptp(points, axis=0).max()) < STANDING:
            message = f"{words} needs poses that differ, the {what} leave the tool at one place in all {count} rows"
            raise InputError(message, file=campaign.file)


def read_registration(file: Path) -> Registration:
    """Read registration.toml.

    Raises:
        InputError: If the file is not a registration.

    """
    table = read_toml_model(RegistrationTable, file)
    return Registration(
        table.base.pose(),
        np.array([tool.pose() for tool in table.tool]),
        tuple(tool.target for tool in table.tool),
        table.fitted,
    )


def write_registration(registration: Registration, file: Path) -> None:
    """Write registration.toml: mm and degrees (rotation vectors)."""
    table: dict[str, Any] = {
        "schema": 1,
        "fitted": list(registration.parts),
        "base": _table(registration.base),
        "tool": [
            {"target": label, **_table(pose)}
            for label, pose in zip(registration.targets, registration.tool, strict=True)
        ],
    }
    write_text(file, tomli_w.dumps(table))


def match_targets(registration: Registration, campaign: Campaign) -> Registration:
    """Order the tools as a campaign numbers its targets; targets that were never fitted get the mean of the others."""
    if registration.targets == campaign.target_names:
        return registration
    known = dict(zip(registration.targets, registration.tool, strict=True))
    tools = np.array([known.get(label, registration.tool[0]) for label in campaign.target_names])
    return Registration(registration.base, tools, campaign.target_names, registration.parts)


def _start_base(p: Array, R: Array, measured: Array, turned: Array | None) -> Array:
    """Start from orientations where there are any, otherwise from the best rigid fit of the positions."""
    base = np.eye(4)
    known = np.zeros(len(p), bool) if turned is None else np.isfinite(turned).all((1, 2))
    if turned is not None and known.sum() >= 3:
        base[:3, :3] = _base_rotation(R[known], turned[known])
    else:
        centred, seen = p - np.median(p, axis=0), measured - np.median(measured, axis=0)
        base[:3, :3] = Rotation.align_vectors(seen, centred)[0].as_matrix()
    base[:3, 3] = np.median(measured - p @ base[:3, :3].T, axis=0)
    return base


def _base_rotation(R: Array, turned: Array) -> Array:
    """Solve R_measured = X R Y for X: relative rotations of both sides have the same axis up to X."""
    pairs = np.random.default_rng(0).integers(0, len(R), (400, 2))
    a = Rotation.from_matrix(R[pairs[:, 0]] @ np.swapaxes(R[pairs[:, 1]], 1, 2)).as_rotvec()
    b = Rotation.from_matrix(turned[pairs[:, 0]] @ np.swapaxes(turned[pairs[:, 1]], 1, 2)).as_rotvec()
    fair = (np.linalg.norm(a, axis=1) > 0.2) & (np.linalg.norm(a, axis=1) < 2.8)
    if fair.sum() < 3:
        return np.eye(3)
    return np.asarray(Rotation.align_vectors(b[fair], a[fair])[0].as_matrix())


def _step(
    p: Array, R: Array, measured: Array, turned: Array | None, tool_of: NDArray[np.int_], base: Array, tools: Array,
    fit_base: bool, n_tools: int,
) -> Array:  # fmt: skip
    """Take one weighted Gauss-Newton step: base twist (6), then a twist per tool (6 each)."""
    size = 6 + 6 * n_tools
    local = tools[tool_of]
    at = p + np.einsum("nij,nj->ni", R, local[:, :3, 3])
    seen = at @ base[:3, :3].T + base[:3, 3]
    world = base[:3, :3] @ R @ local[:, :3, :3]
    jacobian = np.zeros((len(p), 6, size))
    if fit_base:
        jacobian[:, :3, :3], jacobian[:, :3, 3:6], jacobian[:, 3:, 3:6] = np.eye(3), -_cross(seen), np.eye(3)
    for k in range(n_tools):
        rows = tool_of == k
        jacobian[rows, :3, 6 + 6 * k : 9 + 6 * k] = world[rows]
        jacobian[rows, 3:, 9 + 6 * k : 12 + 6 * k] = world[rows]
    residual = np.zeros((len(p), 6))
    residual[:, :3] = measured - seen
    if turned is not None:
        known = np.isfinite(turned).all((1, 2))
        residual[known, 3:] = Rotation.from_matrix(turned[known] @ np.swapaxes(world[known], 1, 2)).as_rotvec()
        jacobian[~known, 3:] = 0.0
    else:
        jacobian[:, 3:] = 0.0
    residual[:, 3:] *= ANGLE_WEIGHT
    jacobian[:, 3:] *= ANGLE_WEIGHT
    length = np.linalg.norm(residual, axis=1)
    knee = 3.0 * max(float(np.median(length)), 1e-9)
    root = np.sqrt(np.minimum(1.0, knee / np.maximum(length, 1e-12)))
    a = (jacobian * root[:, None, None]).reshape(-1, size)
    return np.asarray(np.linalg.lstsq(a, (residual * root[:, None]).reshape(-1), rcond=1e-10)[0])


def _cross(vectors: Array) -> Array:
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], axis=-2)


def _exp(twist: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix()
    pose[:3, 3] = twist[:3]
    return pose


def _table(pose: Array) -> dict[str, list[float]]:
    vector = np.rad2deg(Rotation.from_matrix(pose[:3, :3]).as_rotvec())
    return {"position_mm": [float(v) for v in pose[:3, 3] * 1e3], "rotation_deg": [float(v) for v in vector]}
