"""Results of the posture search: posture, costs, and the start of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.costs import ASSUMED, CHUNK, error_columns, measure_dexterity
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames
from compplan.statics.quality import natural_length
from compplan.toolpath.toolpath import Toolpath, select_even


@dataclass(frozen=True)
class PostureTrace:
    """Posture at every waypoint, unloaded."""

    q: Array  #: Joint positions with the unloaded tool on the path. Shape (n, nq). [rad or m]
    rotation: Array  #: Orientation of the TCP frame, z out of the tool, tilts included. Shape (n, 3, 3).
    spin: Array  #: Rotation about the tool axis, continuous over full turns. Shape (n,). [rad]
    lead: Array  #: Tilt of the tool axis along the path. Shape (n,). [rad]
    lean: Array  #: Tilt of the tool axis to the left of the path. Shape (n,). [rad]
    missed: NDArray[np.bool_]  #: Waypoints where the posture cannot be followed between stations. Shape (n,).


@dataclass(frozen=True)
class PostureSummary(PostureTrace):
    """Posture along an uncorrected path, and its costs."""

    configuration: dict[str, str]  #: Shoulder, elbow and wrist along most of the path.
    #: Changes of configuration: first waypoint afterwards, configuration before, after.
    changes: tuple[tuple[int, str, str], ...]
    settings: PostureSettings  #: Settings of the search.
    costs: dict[str, float]  #: Costs by criterion, with the unit in the key.
    #: Costs of the compared postures, by preset, in the unit of `compared_by`.
    compared: Mapping[str, float] = field(default_factory=dict)
    compared_by: str = ""  #: Cost of the comparison, such as "driven_s".

    @property
    def axis(self) -> Array:
        """Tool axis, tip to spindle, lead and lean included. Shape (n, 3)."""
        return np.asarray(-self.rotation[:, :, 2])

    def describe_errors(self) -> dict[str, Any]:
        """Describe the uncertainty behind the sensitivity for plan.json and place.json."""
        if self.settings.errors is not None:
            return {"error_band_from": self.settings.errors.source}
        return {"uncertainty_assumed": vars(ASSUMED)}

    def describe(self) -> dict[str, Any]:
        """Describe the posture for plan.json."""
        spin = np.degrees(self.spin)
        return {
            "preset": self.settings.preset,
            **self.describe_errors(),
            "costs": dict(self.costs),
            **({} if not self.compared else {f"postures_{self.compared_by}": dict(self.compared)}),
            "spin_deg": {"first": float(spin[0]), "min": float(spin.min()), "max": float(spin.max())},
            "configuration_changes": [
                {"waypoint": waypoint, "from": before, "to": after} for waypoint, before, after in self.changes
            ],
        }


def measure_remaining(problem: PostureProblem, q: Array) -> float:
    """Compute the expected remaining deviation at postures (n, nq) after correction, rms over the cut. [mm]"""
    steps = np.where(problem.nominal.rapid[1:], 0.0, problem.nominal.steps)
    share = np.r_[steps, 0.0] + np.r_[0.0, steps]
    rows = np.flatnonzero(share > 0)
    if not len(rows):
        return 0.0
    rows = select_even(rows, 400)
    spread = error_columns(problem.chain, q[rows], problem.wrench[rows], problem.settings.known, problem.settings.axes)
    weight = share[rows] / share[rows].sum()
    return 1e3 * float(np.sqrt((weight * np.einsum("nij,nij->n", spread, spread)).sum()))


def summarise_costs(problem: PostureProblem, q: Array) -> dict[str, float]:
    """Compute all costs of joint positions q (n, nq) along a path."""
    chain, robot, nominal = problem.chain, problem.robot, problem.nominal
    length, parts = natural_length(chain, robot.arm_limits), np.array_split(q, len(q) // CHUNK + 1)
    dexterity = (measure_dexterity(joint_jacobian(chain, locate_frames(chain, part)), length) for part in parts)
    revolute = ~robot.prismatic
    room = np.minimum(q - robot.lower, robot.upper - q)[:, revolute & ~robot.carriers]
    steps = np.diff(q, axis=0)
    travel = np.abs(steps[:, revolute]).sum()
    feed = np.where(nominal.rapid[1:] | (nominal.feed[1:] <= 0), np.inf, nominal.feed[1:])
    time = np.maximum(nominal.steps / feed, (np.abs(steps) / robot.velocity_limits).max(axis=1))
    return {
        "sensitivity_rms_mm": measure_remaining(problem, q),
        "limit_distance_deg": float(np.degrees(room.min())) if room.size else float("inf"),
        "dexterity_min": min(float(part.min()) for part in dexterity),
        "joint_travel_deg": float(np.degrees(travel)),
        "time_s": float(time.sum()),
    }


class Slowdown(NamedTuple):
    """Slowdown of a run compared with the fastest one: less vibration where the band is widest."""

    window: float  #: Smoothing windows as a share of the default ones.
    places: Array  #: Places along the toolpath in waypoint numbers from 0. Shape (k,).
    slower: Array  #: Slowdown factor of the run there; accelerations fall with its square. Shape (k,).


@dataclass(frozen=True)
class Start:
    """Initial path, posture and speed of a plan."""

    nominal: Toolpath  #: Path with the chosen tilt of the tool axis.
    q: Array  #: Joint positions with the unloaded tool on the path. Shape (n, nq). [rad or m]
    rotation: Array  #: Required orientation of the TCP frame. Shape (n, 3, 3).
    configuration: Mapping[str, str]  #: Shoulder, elbow and wrist along most of the path.
    missed: NDArray[np.bool_]  #: Waypoints out of reach. Shape (n,).
    settings: PostureSettings  #: Settings of the search.
    #: Posture of the graph, or None if infeasible or not searched.
    posture_choice: PostureSummary | None = None
    notes: tuple[str, ...] = ()  #: Notes for the user, one sentence each.
    cause: str = ""  #: Cause and remedy of the first waypoint out of reach, "" if all are reached.
    #: Figures of the program of posture and speed for plan.json; None with the posture of the graph.
    program: Mapping[str, Any] | None = None
    slowdown: Slowdown | None = None  #: Slowdown of the run, None for the fastest one.
    #: Offset from the programmed path within its tube, None for none. Shape (n, 3). [m]
    offset: Array | None = None
    #: Programmed tool axis, None if that of `nominal`. Shape (n, 3).
    programmed_axis: Array | None = None
