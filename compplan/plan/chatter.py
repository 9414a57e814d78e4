"""How far the cut of an end mill is beyond the limit of chatter at any posture, for the choice of a posture.

The zero-order solution (`compplan.process.stability`) with the modes of the arm as it stands; the verdict of
`compplan forces` is by semi-discretisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.job.job import Job
from compplan.job.loading import load_path
from compplan.process.cutting import CuttingForce
from compplan.process.force_law import ForceLaw
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.process.stability import CutDynamics, Modes, find_gains, find_limit
from compplan.robot import Array, Robot
from compplan.simulation.vibration import Dynamics, build_dynamics, find_modes
from compplan.toolpath.contact import path_axes
from compplan.toolpath.toolpath import Toolpath

#: Modes of a posture; the stiffer ones do not take part.
MODES = 5
#: Depths at which chatter is looked for, shares of the one that counts as too deep.
DEPTHS = np.geomspace(0.03, 1.0, 16)
#: What a cut at its limit is beyond it.
LEAST = 1e-3


@dataclass(frozen=True)
class CutChatter:
    """The cut of a path and the robot that makes it.

    Attributes:
        cutting: Engagement along the path.
        nominal: The path, base frame.
        dynamics: The robot with its masses.
        damping: Share of critical damping, assumed.

    """

    cutting: CuttingForce
    nominal: Toolpath
    dynamics: Dynamics
    damping: float

    @property
    def source(self) -> str:
        """Say what is assumed."""
        return f"zero-order solution, damping {100 * self.damping:.3g} % and masses assumed"

    def touches(self, waypoints: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Tell where the cutter is in material. Shape (m,)."""
        return np.asarray(self.cutting.engagement.touches[self._rows[waypoints]] & ~self.nominal.rapid[waypoints])

    def excess(self, q: Array, waypoints: NDArray[np.int_], reserve: float) -> Array:
        """Return by which share `reserve` times the cut's depth lies beyond the limit of chatter, 0 for none.

        Args:
            q: Joint positions. Shape (m, nq). [rad or m]
            waypoints: Where on the path. Shape (m,).
            reserve: Factor on the depth.

        Returns:
            Shape (m,).

        """
        found, beyond = self.cutting.engagement, np.zeros(len(q))
        spindle, process = self.cutting.process.spindle(), self.cutting.process
        place, which = np.unique(waypoints, return_inverse=True)
        rows = self._rows[place]
        gains = find_gains(found.take(rows), process.resistance, spindle.feed_per_tooth(self.nominal.feed[place]))
        period, axes = 1.0 / (spindle.speed * spindle.teeth), path_axes(self.nominal)[place]
        for i, own in enumerate(find_modes(self.dynamics, q, MODES)):
            modes = Modes(own.omega, own.tip, self.damping).turn(axes[which[i]])
            limit = find_limit(CutDynamics(reserve * gains[which[i]], spindle.teeth, period, modes), DEPTHS)
            beyond[i] = 1.0 / limit - 1.0 + LEAST if np.isfinite(limit) else 0.0
        return beyond

    @cached_property
    def _rows(self) -> NDArray[np.int_]:
        """Waypoint of the engagement that each waypoint of the path stands at. Shape (n,)."""
        after = np.clip(np.searchsorted(self.cutting.arc, self.nominal.arc_length), 1, len(self.cutting.arc) - 1)
        back = self.nominal.arc_length - self.cutting.arc[after - 1] < self.cutting.arc[after] - self.nominal.arc_length
        return np.asarray(after - back)


def read_chatter(job: Job, robot: Robot, nominal: Toolpath, law: ForceLaw | None) -> CutChatter | None:
    """Return what the posture pays for chatter, None where the job does not ask for it.

    Raises:
        InputError: If it is asked for and cannot be judged.

    """
    if not job.stability.avoid:
        return None
    if law is None or law.cutting is None or not isinstance(job.process, EndMillProcess):
        message = f"is true, but chatter is looked at for the model 'end_mill' alone, not for {job.process.model!r}"
        raise InputError(message, file=job.file, where="stability.avoid")
    dynamics = build_dynamics(robot)
    if not dynamics.known:
        message = f"is true, but the folder of robot {robot.name!r} knows no masses or no springs"
        raise InputError(message, file=job.file, where="stability.avoid")
    return CutChatter(law.cutting, nominal, dynamics, job.stability.damping)


def price_places(job: Job, robot: Robot) -> Callable[[Toolpath], CutChatter | None]:
    """Return what a posture pays for chatter along the job's path wherever its part stands.

    The engagement is the part's own, so that it is worked out once.

    Raises:
        InputError: If the job asks for it and it cannot be judged.

    """
    if not job.stability.avoid:
        return lambda nominal: None
    nominal, law = load_path(job)
    read_chatter(job, robot, nominal, law)
    return lambda moved: read_chatter(job, robot, moved, law)
