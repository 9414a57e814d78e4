"""A path as its pose equations see it: what has to hold at every waypoint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.robot import Array
from compplan.statics.chain import Chain


def leaves_axis(chain: Chain) -> bool:
    """Tell whether an arm has too few joints to choose where its tool points (palletisers, arms like a SCARA)."""
    return chain.nq < 5


def count_equations(chain: Chain, *, spin_free: bool) -> int:
    """Count the pose equations of a waypoint: tip, tool axis where the arm chooses it, spin where it is not free."""
    return (3 if leaves_axis(chain) else 5) + (not spin_free)


@dataclass(frozen=True)
class PathProblem:
    """What a compensated path has to fulfil; n waypoints, nq joints, base frame.

    Attributes:
        chain: The elastic chain with the tool.
        position: Wanted tool tip. Shape (n, 3). [m]
        rotation: Wanted orientation of the TCP frame; its z (out of the tool) is binding, its x only where the spin is
            not free. Shape (n, 3, 3).
        wrench: Wrench of the environment on the tool at the TCP. Shape (n, 6). [N, N m]
        compensated: Waypoints where the loaded tool is to stand on the path, at the others the unloaded. Shape (n,).
        q_start: Posture that the plan keeps near. Shape (n, nq). [rad or m]
        step_time: Time from each waypoint to the next at the programmed feed. Shape (n - 1,). [s]
        lower: Lower position limits. Shape (nq,). [rad or m]
        upper: Upper position limits. Shape (nq,). [rad or m]
        velocity_limits: Velocity limits. Shape (nq,). [rad/s or m/s]
        acceleration_limits: Acceleration limits. Shape (nq,). [rad/s^2 or m/s^2]
        max_correction: Greatest distance of the unloaded tip from the path. [m]
        spin_free: Whether the rotation about the tool axis is free.
        still: Joints that keep q_start: rails, whose small motions are lost. Shape (nq,); none if left out.
        weight: What motion of each joint is worth, see `weigh_joints`. Shape (nq,); 1 if left out.

    """

    chain: Chain
    position: Array
    rotation: Array
    wrench: Array
    compensated: NDArray[np.bool_]
    q_start: Array
    step_time: Array
    lower: Array
    upper: Array
    velocity_limits: Array
    acceleration_limits: Array
    max_correction: float = np.inf
    spin_free: bool = True
    still: NDArray[np.bool_] | None = None
    weight: Array | None = None

    def __post_init__(self) -> None:
        n, nq = len(self.position), self.chain.nq
        shapes = {"position": (n, 3), "rotation": (n, 3, 3), "wrench": (n, 6), "compensated": (n,), "q_start": (n, nq)}
        shapes |= {"step_time": (n - 1,), "lower": (nq,), "upper": (nq,)}
        shapes |= {"velocity_limits": (nq,), "acceleration_limits": (nq,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ShapeError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")

    @property
    def stays(self) -> NDArray[np.bool_]:
        """Tell which joints keep q_start. Shape (nq,)."""
        return np.zeros(self.chain.nq, bool) if self.still is None else self.still

    @property
    def worth(self) -> Array:
        """What motion of each joint is worth. Shape (nq,)."""
        return np.ones(self.chain.nq) if self.weight is None else self.weight

    @property
    def equations(self) -> int:
        """Count the pose equations of a waypoint."""
        return count_equations(self.chain, spin_free=self.spin_free)

    @property
    def axis_free(self) -> bool:
        """Tell whether the tool axis follows from the tip: four joints cannot choose it."""
        return leaves_axis(self.chain)

    @property
    def redundant(self) -> bool:
        """Tell whether a waypoint leaves the joints any freedom."""
        return self.chain.nq - int(self.stays.sum()) > self.equations
