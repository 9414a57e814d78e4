"""The bench of the thresholds' probes: small campaigns, their fits, and answers as rounded numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnose import (
    campaign_diagnosis,
    doubt,
    fit,
    search,
    state,
)
from compplan.effects import Effect
from compplan.measure.campaign import Campaign
from compplan.robot import Robot

#: A soft joint, play and a gear error: what the small campaign holds; and a bent link that it is not told of.
CAUSES = [
    Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": 4e-7}),
    Effect("backlash", "joint_4", None, {"width_rad": 3e-4}),
    Effect("joint_offset", "joint_5", None, {"offset_rad": 6e-4}),
]


def digest(value: Any) -> Any:
    """Return an answer as nested tuples of rounded numbers and words."""
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(digest(getattr(value, f.name)) for f in fields(value) if f.name not in ("progress", "cache"))
    if isinstance(value, dict):
        return tuple((str(key), digest(entry)) for key, entry in value.items())
    if isinstance(value, list | tuple | set | frozenset):
        return tuple(digest(entry) for entry in value)
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "f":
            return (value.shape, value.tobytes() if value.dtype.kind in "biu" else str(value.tolist()))
        size = 10.0 ** np.floor(np.log10(np.maximum(np.abs(value), 1e-300)))
        return (value.shape, (np.round(value / size, 5) + 0.0).tobytes(), size.tobytes())
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}") if np.isfinite(value) else str(value)
    return value if isinstance(value, int | str | bool | None.__class__) else str(type(value))


@dataclass(eq=False)
class Bench:
    """A robot, campaigns, and a fit that the probes of later stages begin with."""

    folder: Path

    @cached_property
    def robot(self) -> Robot:
        return write_small_robot(self.folder / "small")

    @cached_property
    def campaign(self) -> Campaign:
        """Poses under loads and a path; the fifth row is a gross error, and something oscillates on the path."""
        seen = measure(self.robot, plan_rows(self.robot, 20, poses=16, loads=1, path=64), CAUSES, 20, encoders=True)
        position = seen.position.copy()
        position[5] += [0.02, 0.0, 0.0]
        position[seen.on_path, 2] += 1.2e-4 * np.sin(2 * np.pi * 3.1 * seen.time[seen.on_path])
        return replace(seen, position=position)

    @cached_property
    def fit(self) -> state.Fit:
        """The fit of that campaign."""
        problem = state.Problem(self.robot, self.campaign)
        return fit.fit_effects(problem, None)

    @cached_property
    def few(self) -> Campaign:
        """Fewer poses, positions alone, no clock: for stages that weigh every claim once more."""
        rows = replace(plan_rows(self.robot, 20, poses=14, loads=1), time=None)
        causes = [CAUSES[0], CAUSES[2], Effect("joint_offset", "joint_2", None, {"offset_rad": 2.5e-5})]
        return measure(self.robot, rows, causes, 20, orientation=False)

    @cached_property
    def small_fit(self) -> state.Fit:
        return fit.fit_effects(state.Problem(self.robot, self.few), None)

    @cached_property
    def doubt(self) -> doubt.Doubt:
        return doubt.raise_doubt(self.small_fit)

    @cached_property
    def diagnosis(self) -> Any:
        return campaign_diagnosis.diagnose_campaign(self.robot, self.few)

    def fresh_search(self) -> search.Search:
        return replace(self.fit.search, cache={})
