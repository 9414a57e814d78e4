"""Registration: frames of one campaign - pose of the instrument, position of the target on the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import write_text
from compplan.io.tomlfile import SchemaOne, StrictTable, Vector3, read_toml_model
from compplan.measurement.campaign import Campaign
from compplan.measurement.observations import CONTACT
from compplan.robot import Array, Robot
from compplan.robot.pose import build_pose

PARTS = ("base", "tool")
#: Fitted contact positions of other instruments.
CONTACTS = "contact"
#: Greatest distance of a registered frame; angles are far below this number in degrees. [mm]
FARTHEST_MM = 1e6


@dataclass(frozen=True, eq=False)
class Registration:
    """Frames fitted to one campaign."""

    base: Array  #: Pose of the robot base in the measurement frame. Shape (4, 4). [m]
    tool: Array  #: Pose of each target in the TCP frame. Shape (targets, 4, 4). [m]
    targets: tuple[str, ...] = ("",)  #: Label of each target.
    parts: tuple[str, ...] = PARTS  #: Fitted frames, of "base", "tool" and "contact".
    contacts: tuple[str, ...] = ()  #: Label of each contact of the campaign.
    #: Contact positions, base frame of the robot. Shape (contacts, 3). [m]
    places: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @staticmethod
    def identity(campaign: Campaign, parts: Sequence[str] = PARTS) -> Registration:
        """Return the identity registration: the target is the TCP, or at the target offset of the campaign."""
        tools = np.repeat(np.eye(4)[None], len(campaign.target_names), axis=0)
        if campaign.target_offset is not None:
            tools[:, :3, 3] = campaign.target_offset
        contacts = () if campaign.observations is None else campaign.observations.names
        return Registration(
            np.eye(4), tools, campaign.target_names, tuple(parts), contacts, np.zeros((len(contacts), 3))
        )

    def locate_targets(self, campaign: Campaign, position: Array, rotation: Array) -> Array:
        """Return the targets of TCP poses in the measurement frame. Shape (n, 3). [m]"""
        tool = self.tool[campaign.target_index, :3, 3]
        point = position + np.einsum("nij,nj->ni", rotation, tool)
        return np.asarray(point @ self.base[:3, :3].T + self.base[:3, 3])


def fitted_parts(campaign: Campaign, parts: Sequence[str]) -> tuple[str, ...]:
    """Return the frames to fit for a campaign: the requested ones, and unknown contact positions.

    The base frame is left out if no row has a position: other observations do not depend on it.
    """
    kept = [part for part in parts if part != "base" or campaign.observations is None or campaign.measured.any()]
    if campaign.observations is not None and campaign.observations.names and CONTACTS not in kept:
        kept.append(CONTACTS)
    return tuple(kept)


def campaign_gap(campaign: Campaign, position: Array, registration: Registration | None) -> Array:
    """Return measured minus expected, base axes, of positions and other observations. Shape (n, 3). [m]

    position: measured point by a model, measuring frame, (n, 3) [m]; registration: fitted frames, None if the
    measuring frame is the robot's base frame.
    """
    gap = campaign.position - position
    if registration is not None:
        gap = gap @ registration.base[:3, :3]
        position = (position - registration.base[:3, 3]) @ registration.base[:3, :3]
    if campaign.observations is None:
        return np.asarray(gap)
    places = _places_of(campaign, registration, position)
    return np.where(campaign.observations.observed[:, None], campaign.observations.gap(position, places), gap)


def campaign_turn(campaign: Campaign, rotation: Array) -> Array:
    """Return the rotation from expected, (n, 3, 3), to measured, measuring axes, NaN if unknown. Shape (n, 3). [rad]"""
    turn = np.full((len(campaign), 3), np.nan)
    if campaign.rotation is not None:
        known = campaign.usable & np.isfinite(campaign.rotation).all(axis=(1, 2))
        product = campaign.rotation[known] @ np.swapaxes(rotation[known], 1, 2)
        turn[known] = Rotation.from_matrix(product).as_rotvec() if known.any() else np.zeros((0, 3))
    return turn


def campaign_directions(campaign: Campaign, position: Array, registration: Registration | None) -> Array | None:
    """Return the direction of observations of one component, NaN for three, base axes; None if all have three.

    Arguments: see `campaign_gap`.
    """
    if campaign.observations is None or (campaign.observations.kind <= CONTACT).all():
        return None
    if registration is not None:
        position = (position - registration.base[:3, 3]) @ registration.base[:3, :3]
    return campaign.observations.directions(position, _places_of(campaign, registration, position))


def _places_of(campaign: Campaign, registration: Registration | None, point: Array) -> Array:
    """Return the contact positions of a campaign, estimated from its rows if the registration does not have them."""
    assert campaign.observations is not None
    if registration is not None and registration.contacts == campaign.observations.names:
        return registration.places
    return campaign.observations.start_places(point)


def stated_registration(campaign: Campaign) -> Registration | None:
    """Return the registration by the target offset of a campaign, or None without a target offset."""
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
        """Return the pose as a matrix. Shape (4, 4) [m]."""
        turn = Rotation.from_rotvec(np.deg2rad(self.rotation_deg))
        return build_pose(np.array(self.position_mm) * 1e-3, turn.as_matrix())


class TargetTable(RegistrationPose):
    """[[tool]]: a target in the TCP frame."""

    target: str = ""


class RegisteredContact(StrictTable):
    """[[contact]]: position of a contact in the base frame of the robot."""

    label: str
    position_mm: Annotated[Vector3, AfterValidator(_check_near)]


class RegistrationTable(StrictTable):
    """registration.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    fitted: Annotated[tuple[Literal["base", "tool", "contact"], ...], Field(strict=False)]
    base: RegistrationPose
    tool: Annotated[tuple[TargetTable, ...], Field(strict=False, min_length=1)]
    contact: Annotated[tuple[RegisteredContact, ...], Field(strict=False)] = ()


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
        tuple(contact.label for contact in table.contact),
        np.array([contact.position_mm for contact in table.contact]).reshape(-1, 3) * 1e-3,
    )


def folder_registration(robot: Robot) -> Registration | None:
    """Return the frames of a robot folder's registration.toml, or None."""
    file = None if robot.folder is None else robot.folder / "registration.toml"
    return read_registration(file) if file is not None and file.exists() else None


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
    if registration.contacts:
        places = zip(registration.contacts, registration.places * 1e3, strict=True)
        table["contact"] = [{"label": label, "position_mm": [float(v) for v in place]} for label, place in places]
    write_text(file, tomli_w.dumps(table))


def match_targets(registration: Registration, campaign: Campaign) -> Registration:
    """Order the tools by the targets of a campaign; targets that were not fitted get the first tool."""
    if registration.targets == campaign.target_names:
        return registration
    known = dict(zip(registration.targets, registration.tool, strict=True))
    tools = np.array([known.get(label, registration.tool[0]) for label in campaign.target_names])
    return replace(registration, tool=tools, targets=campaign.target_names)


def _table(pose: Array) -> dict[str, list[float]]:
    vector = np.rad2deg(Rotation.from_matrix(pose[:3, :3]).as_rotvec())
    return {"position_mm": [float(v) for v in pose[:3, 3] * 1e3], "rotation_deg": [float(v) for v in vector]}
