"""A task's force and deflection in agreement, where its job says how the force answers to where the tool is.

A plan whose loaded tool stands on the path meets the force that is predicted on the path: its correction is the same
with and without. What differs is what is left where the tool is off its path: uncorrected, after one mirror, in a robot
that is not as modelled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compplan.plan.task import PlanTask
from compplan.robot import Array
from compplan.simulation.cell import CellRun
from compplan.simulation.coupling import Settled, settle_coupled


@dataclass(frozen=True)
class CouplingEffect:
    """What it makes of the uncorrected tip that the force depends on where the tool is.

    Attributes:
        source: Where the process stiffness comes from.
        stiffness: Greatest stiffness along each base axis over the cut. Shape (3,). [N/m]
        without: Root mean square deviation along each base axis of the uncorrected tip under the force on the path.
            Shape (3,). [m]
        coupled: The same with coupling. Shape (3,). [m]
        without_size: Root mean square and greatest distance without. [m]
        coupled_size: The same with coupling. [m]
        settled: Force and deflection of the uncorrected command.

    """

    source: str
    stiffness: Array
    without: Array
    coupled: Array
    without_size: tuple[float, float]
    coupled_size: tuple[float, float]
    settled: Settled

    @property
    def left(self) -> Array:
        """Share of the deviation that is left along each base axis; 1 where there was none. Shape (3,)."""
        return np.asarray(np.where(self.without > 1e-9, self.coupled / np.maximum(self.without, 1e-9), 1.0))


def find_stiffness(task: PlanTask, wrench: Array | None = None) -> Array | None:
    """Return the process stiffness along a task, base axes, or None where the force asks not where the tool is.

    Args:
        task: The task.
        wrench: Wrench on a tool that stands on the path, the task's if left out. Shape (n, 6). [N, N m]

    Returns:
        Shape (n, 3, 3). [N/m]

    """
    if task.law is None or task.law.coupling is None:
        return None
    driven = replace(task.nominal, feed=_driven_feed(task))
    return task.law.coupling.along(driven, task.wrench if wrench is None else wrench)


def respond_in_line(stiffness: Array, away: Array) -> Array:
    """Return by how much the wrench changes in proportion to where the tool is off its path. Shape (n, 6). [N, N m]"""
    return np.hstack([-np.einsum("nij,nj->ni", stiffness, away), np.zeros((len(away), 3))])


def settle_task(
    task: PlanTask,
    attain: Callable[[Array], CellRun],
    compliance: Array,
    *,
    wrench: Array | None = None,
    stiffness: Array | None = None,
) -> Settled:
    """Let force and deflection of a command agree; the task's job has to say how the force answers.

    Args:
        task: The task.
        attain: Where the loaded tool goes under a wrench.
        compliance: Of the tip. Shape (n, 3, 3). [m/N]
        wrench: Wrench on a tool that stands on the path, the task's if left out. Shape (n, 6). [N, N m]
        stiffness: Process stiffness, where another reading of the job is meant than the task's; the force then answers
            in proportion. Shape (n, 3, 3). [N/m]

    """
    law, load = task.law, task.wrench if wrench is None else wrench
    slope = find_stiffness(task, load) if stiffness is None else stiffness
    assert law is not None and slope is not None
    driven = replace(task.nominal, feed=_driven_feed(task))

    def respond(away: Array) -> Array:
        return respond_in_line(slope, away) if stiffness is not None else law.respond(driven, load, slope, away)

    return settle_coupled(
        attain, respond, position=task.position, wrench=load, compliance=compliance, stiffness=slope
    )


def measure_coupling(task: PlanTask, without: Array, coupled: Array, settled: Settled) -> CouplingEffect:
    """Put the uncorrected tip without and with coupling side by side.

    Args:
        task: The task.
        without: Deviation under the force on the path. Shape (n, 3). [m]
        coupled: Deviation under the force where the tool is. Shape (n, 3). [m]
        settled: How they came to agree.

    """
    assert task.law is not None and task.law.coupling is not None
    rows = np.flatnonzero(task.cut & (np.abs(task.wrench[:, :3]).max(axis=1) > 0.0))
    rows = rows if len(rows) else np.flatnonzero(task.cut)
    stiffness = find_stiffness(task)
    assert stiffness is not None
    axes = [np.sqrt(np.mean(side[rows] ** 2, axis=0)) for side in (without, coupled)]
    sizes = [np.linalg.norm(side[task.cut], axis=1) for side in (without, coupled)]
    figures = [(float(np.sqrt(np.mean(size**2))), float(size.max())) for size in sizes]
    most = np.asarray(np.einsum("nii->ni", stiffness)[rows].max(axis=0))
    return CouplingEffect(task.law.coupling.source, most, axes[0], axes[1], figures[0], figures[1], settled)


def _driven_feed(task: PlanTask) -> Array:
    """Return the feed of the move that ends at each waypoint as it is timed. Shape (n,). [m/s]"""
    moving = task.step_time > 0.0
    feed = np.where(moving, task.nominal.steps / np.where(moving, task.step_time, 1.0), task.nominal.feed[1:])
    return np.asarray(np.r_[feed[:1], feed])


def summarise_coupling(effect: CouplingEffect) -> dict[str, Any]:
    """Return what plan.json says of force and place: the uncorrected tip without and with their coupling."""
    settled = effect.settled
    sides = (("without", effect.without, effect.without_size), ("coupled", effect.coupled, effect.coupled_size))
    return {
        "source": effect.source,
        "stiffness_N_mm": [1e-3 * float(value) for value in effect.stiffness],
        "passes": settled.passes,
        "ratio": settled.ratio,
        "agrees": settled.agrees,
        "unsettled": settled.unsettled,
        "missing_mm": 1e3 * float(settled.missing[settled.worst]),
        "missing_at": settled.worst,
        "error_before_mm": {
            name: {"rms": 1e3 * size[0], "max": 1e3 * size[1], "xyz_rms": [1e3 * float(value) for value in axes]}
            for name, axes, size in sides
        },
        "left": [float(value) for value in effect.left],
    }
