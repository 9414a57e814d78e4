"""Finished walls of a job: what arm, tool and thin walls leave, uncorrected in a prediction, corrected in a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from compplan.job.job import Job
from compplan.process.force_law import ForceLaw
from compplan.process.walls import MOST, WallError, judge_walls
from compplan.robot import Array
from compplan.toolpath.toolpath import Toolpath, interpolate


def judge_surface(
    job: Job | None, law: ForceLaw | None, nominal: Toolpath, away: Array
) -> tuple[WallError, ...] | None:
    """Work out the errors of finished walls; None where the job does not ask for them or no side of a cutter cuts.

    Args:
        job: The job.
        law: The law of its force.
        nominal: The path, base frame, with the feed that is driven.
        away: Where the arm puts the tip, minus path. Shape (n, 3). [m]

    """
    if job is None or job.surface is None or law is None or law.cutting is None or law.cutting.process.steady:
        return None
    cutting = law.cutting
    cutter = cutting.bench.cutter
    beam = None if job.tool_beam is None else job.tool_beam.build(2.0 * cutter.radius, cutter.flute)
    part = away @ law.T_base_part[:3, :3]
    there = interpolate(cutting.arc, nominal.arc_length, part)
    ending = np.minimum(np.searchsorted(nominal.arc_length, cutting.arc - 1e-12), len(nominal) - 1)
    return judge_walls(cutting, nominal.feed[ending], there, beam, job.surface.wall)


def describe_walls(walls: Sequence[WallError], job: Job | None, *, corrected: bool) -> dict[str, Any]:
    """Return what a file holds of finished walls."""
    told = {"arm": "corrected" if corrected else "uncorrected", "walls": [wall.describe() for wall in walls]}
    return {**told, "greatest_mm": 1e3 * find_greatest(walls), "assumed": explain_walls(job)}


def find_greatest(walls: Sequence[WallError]) -> float:
    """Return the error of all walls that is farthest from 0; 0 where there are none. [m]"""
    return max((wall.greatest for wall in walls), key=abs, default=0.0)


def explain_walls(job: Job | None) -> list[str]:
    """Say what the errors take for true, one sentence each."""
    thin = () if job is None or job.surface is None else job.surface.wall
    bends = job is not None and job.tool_beam is not None
    tool = ("The tool bends as a beam whose clamp and spindle are rigid (assumed)." if bends else
            "The tool and its holder count as rigid: [tool_beam] says how they bend.")  # fmt: skip
    walls = (f"{len(thin)} thin walls give at once (no inertia), with the thickness that is left after the cut." if thin
             else "The work counts as rigid: [[surface.wall]] describes thin walls.")  # fmt: skip
    left = "Chatter, run-out, floors and steps between passes are left out"
    return [tool, walls, f"{left}; of many walls the {MOST} longest are looked at."]
