"""Robots of a study, drawn from the uncertainty of the robot folder.

The coordinates of a sample define one draw of all parameters, p = S z, and one of the unexplained error. Compliances of
driven springs, zeros, lost motion and gear errors act at the joints, so that encoders measure them; all other
parameters move the tip to first order. If force and robot were learned together from a measured part, level and
rotations of the force are correlated with the parameters, as in the error band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects import transmission_error
from compplan.effects.forward_model import ForwardModel, own_springs
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import Slopes
from compplan.uncertainty.sensitivities import ForceSpread, measure_slopes, tie_force
from compplan.uncertainty.touch_off import TouchedPart

#: Modes of the unexplained error per axis.
MODES = 12
#: Least factor on the compliance of a spring.
LEAST = 0.02


class ArmParameter(NamedTuple):
    """A parameter that acts inside the arm."""

    row: int  #: Row among the parameters.
    kind: str  #: "factor", "zero" or "drive".
    place: int  #: Index of the elastic coordinate, or of the joint.
    shape: Array  #: Change per unit: 1 / compliance, 1, or motion of the drive along the path, shape (n,).


@dataclass(frozen=True, eq=False)
class RobotPosterior:
    """Parameter uncertainty of a robot, prepared for sampling."""

    root: Array  #: Parameters per normal coordinate. Shape (p, r). [SI]
    parts: tuple[ArmParameter, ...]  #: Parameters that act inside the arm; the others move the tip.
    #: Correlated and independent part of the force (`tie_force`); None: all is independent.
    tie: tuple[Array, Array] | None = None

    def push(self, z: Array, shares: Array) -> Array:
        """Combine coordinates of the robot and independent shares to level and rotations of the force. (4, b)."""
        if self.tie is None:
            return shares
        tied, apart = self.tie
        return np.asarray(tied @ z[: tied.shape[1]] + apart @ shares)

    def draw(self, z: Array, factor: Array, zero: Array) -> None:
        """Add parameters of b samples to factors (s, b) and zeros (nq, b). z: (m, b)."""
        values = self.root @ z[: self.root.shape[1]]
        for part in self.parts:
            if part.kind == "factor":
                factor[part.place] = np.maximum(factor[part.place] + part.shape * values[part.row], LEAST)
            elif part.kind == "zero":
                zero[part.place] += values[part.row]

    def draw_drives(self, z: Array, drive: Array) -> Array:
        """Add the errors of the drives of b samples to `drive`, (nq, b, n), and return it. z: (m, b)."""
        values = self.root @ z[: self.root.shape[1]]
        for part in self.parts:
            if part.kind == "drive":
                drive[part.place] += values[part.row][:, None] * part.shape
        return drive


def count_coordinates(robot: Robot) -> int:
    """Return the number of coordinates of a draw: parameters, and three times MODES for the unexplained error."""
    return robot_uncertainty(robot).factor.shape[1] + 3 * MODES


def build_posterior(robot: Robot, q: Array, motion_sign: Array, force: ForceSpread | None = None) -> RobotPosterior:
    """Build the posterior of a robot at joint positions q, (n, nq).

    motion_sign: direction of motion of each joint, (nq, n); force: uncertainty of the force, or None for no force.
    """
    known = robot_uncertainty(robot)
    found = RobotPosterior(known.spread, _list_parts(robot, known, q, motion_sign))
    if force is None or not len(force.robot):
        return found
    return replace(found, tie=tie_force(known, force))


def move_by_parameters(scene: ForwardModel, rows: NDArray[np.int_], posterior: RobotPosterior) -> Array:
    """Return the motion of the tip by each parameter coordinate, of parameters outside the arm. Shape (r, k, 3). [m]

    The coordinates are those of `posterior`; rows: of the path of the forward model, k of them.
    """
    unknowns = robot_uncertainty(scene.robot).unknowns
    slopes = measure_slopes(scene, unknowns, rows)
    slopes[:, :, [part.row for part in posterior.parts]] = 0.0
    return np.moveaxis(slopes @ posterior.root, 2, 0)


def move_by_smooth_errors(place: Array, known: Uncertainty, touched: TouchedPart | None) -> Array:
    """Return the motion of the tip at places (k, 3) by the leading modes of the unexplained error. (3 MODES, k, 3). [m]

    It counts from the part as located by touch-off, if there is one.
    """
    k, none = len(place), np.zeros((len(place), 3, 0))
    path = Slopes(np.arange(k), place, none, none, none, touched=touched)
    modes = path.smooth_columns(known).reshape(k, 3, -1, 3)[:, :, ::-1][:, :, :MODES].reshape(k, 3, -1)
    return np.moveaxis(np.pad(modes, ((0, 0), (0, 0), (0, 3 * MODES - modes.shape[2]))), 2, 0)


def _list_parts(robot: Robot, known: Uncertainty, q: Array, motion_sign: Array) -> tuple[ArmParameter, ...]:
    parts, first = [], 0
    own, names = own_springs(robot), [joint.name for joint in robot.actuated]
    for unknown in known.unknowns:
        joint = names.index(unknown.joint) if unknown.joint in names else -1
        one = np.ones(1)
        if unknown.effect == "joint_stiffness" and joint in own and own[joint].compliance > 0.0:
            parts.append(ArmParameter(first, "factor", own[joint].coordinate, one / own[joint].compliance))
        elif unknown.effect == "joint_offset":
            parts.append(ArmParameter(first, "zero", joint, one))
        elif unknown.effect == "backlash":
            parts.append(ArmParameter(first, "drive", joint, -0.5 * motion_sign[joint]))
        elif unknown.effect == transmission_error.name and "cycles_per_turn" in unknown.fixed:
            shape = transmission_error.waves(q[:, joint], unknown.fixed["cycles_per_turn"], False)
            parts += [ArmParameter(first + k, "drive", joint, column) for k, column in enumerate(shape.T)]
        first += len(unknown.keys)
    return tuple(parts)
