"""Result of planning: task, command, timing, checks, error band, verdict, and the contents of plan.json."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from compplan.errors import ConvergenceError
from compplan.io.display import Curve, Curves, Shown
from compplan.io.notes import Stop, list_stops
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_number
from compplan.job.job import Job
from compplan.job.noise import NoiseTable
from compplan.planning.approach import AuxiliaryMotion
from compplan.planning.checks import STOP, Check
from compplan.planning.executed import ExecutedPath
from compplan.planning.posture.clearance import ClearanceProfile, summarise_clearance
from compplan.planning.sampling import Between
from compplan.planning.task import CORRECTION_LIMIT, Command, PlanTask
from compplan.planning.timing import Timing
from compplan.planning.tolerance_verdict import NO_BAND, ToleranceVerdict, check_tolerance
from compplan.robot import Array, Robot
from compplan.simulation.simulated_robot import EXACT_EVALUATION, Evaluation
from compplan.statics.chain import locate_frames
from compplan.uncertainty.band import ErrorBand, estimate_band
from compplan.uncertainty.motion import Motion, greatest_shift
from compplan.uncertainty.sensitivities import build_path_model, read_force_spread
from compplan.uncertainty.touch_off import describe_placement, read_touch, touch_part

#: Most limits listed in a sentence.
LISTED = 3


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """Plan with its input and intermediate results."""

    name: str  #: Name of the job.
    task: PlanTask  #: Robot, nominal path, predicted wrench, posture, limits.
    strategy: str  #: Compensation strategy.
    command: Command  #: Joint positions, status, failures, figures of the solver.
    timing: Timing  #: Times, joint rates and feeds of the command.
    before: Evaluation  #: Deviation of the uncorrected command (`task.q_uncorrected`) as modelled.
    after: Evaluation  #: Deviation of the command in the independent check, as modelled.
    approach: AuxiliaryMotion  #: Motion to the first waypoint, if the toolpath does not start with a rapid move.
    retract: AuxiliaryMotion  #: Motion from the last waypoint, if the toolpath ends in a cut.
    between: Between  #: Deviation of the loaded tip between waypoints, by the planner's model.
    motion: Motion | None  #: Contribution of the motion of the arm to the band; None without masses on springs.
    checks: tuple[Check, ...] = ()  #: Checks with values and limits, and notes.
    clearance: ClearanceProfile | None = None  #: Clearance of arm and tool from part and fixture, or None.
    job: Job | None = None  #: The job, or None.
    #: Executed path of controller and programs; None if not simulated.
    executed: ExecutedPath | None = None
    learned: ErrorBand | None = None  #: Uncertainty of the tip learned from measured parts on this path, or None.

    @property
    def robot(self) -> Robot:
        """The robot model with its tool."""
        return self.task.robot

    @property
    def q(self) -> Array:
        """Commanded joint positions. Shape (n, nq). [rad or m]."""
        return self.command.q

    @cached_property
    def breaches(self) -> tuple[str, ...]:
        """Reasons why the independent check does not confirm the plan, one sentence each."""
        return tuple(check.sentence for check in self.checks if check.fails and check.severity == STOP)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Warnings, one sentence each; those of the class `Stop` must be resolved before the machine moves."""
        return tuple(check.sentence for check in self.checks if check.fails and check.severity != STOP)

    @property
    def reasons(self) -> tuple[Stop, ...]:
        """Reasons why a plan is not confirmed, one sentence each; empty for other plans."""
        return tuple(Stop(f"Not confirmed: {text}.") for text in self.breaches if self.status == "not_confirmed")

    def add_checks(self, checks: tuple[Check, ...], *, first: bool = False) -> Plan:
        """Return the plan with more checks; results that do not depend on checks stay cached."""
        added = copy(self)
        object.__setattr__(added, "checks", (*checks, *self.checks) if first else (*self.checks, *checks))
        for name in ("breaches", "notes", "verdict"):
            added.__dict__.pop(name, None)
        return added

    @property
    def status(self) -> str:
        """Status: "solved", "infeasible" or "not_confirmed"."""
        return "not_confirmed" if self.command.status == "solved" and self.breaches else self.command.status

    @cached_property
    def correction(self) -> Array:
        """Unloaded tip of the command minus nominal. Shape (n, 3). [m]"""
        return locate_frames(self.task.chain, self.q).tcp_position - self.task.position

    @cached_property
    def inertia(self) -> float:
        """Greatest displacement of the tip in the cut by the inertia of the motion; NaN without masses. [m]"""
        return float("nan") if self.motion is None else greatest_shift(self.motion.answer[self.task.cut])

    @property
    def max_correction(self) -> float:
        """Greatest correction in the cut. [m]"""
        return float(np.linalg.norm(self.correction[self.task.compensated], axis=1).max(initial=0.0))

    @property
    def limit_room(self) -> tuple[float, str]:
        """Least distance of any joint from its position limits (negative beyond), and its name. [rad or m]"""
        room = np.minimum(self.q - self.robot.lower, self.robot.upper - self.q).min(axis=0)
        room = np.where(self.robot.lower == self.robot.upper, np.inf, room)  # fixed by the job
        return float(room.min()), self.robot.joint_names[int(room.argmin())]

    @cached_property
    def error_band(self) -> ErrorBand | None:
        """The 95 % band of the true tip; None if infeasible, or without equilibrium of a robot within the band."""
        if self.learned is not None or self.status == "infeasible":
            return self.learned
        task = self.task
        bow = max(self.between.max_deviation - self.after.max_deviation, 0.0)
        scene = build_path_model(task.robot, self.q, task.wrench, task.step_time)
        noise = NoiseTable() if self.job is None else self.job.noise
        left, output = self.after.distance, None if self.job is None else self.job.output
        if self.executed is not None:
            left = np.maximum(left, self.executed.near)
        if task.nominal.rounded is not None:
            left = left + task.nominal.rounded
        if output is not None and output.programs and output.form != "joint" and self.executed is None:
            bow += output.bound_fit(task.tolerance)
        touchable = None
        if task.touched is None and self.job is not None:
            touchable = touch_part(task.robot, task.nominal, task.rotation, task.q_start, read_touch(self.job))
        try:
            band = estimate_band(task.robot, scene, task.cut, read_force_spread(self.job), left=left,
                                between=bow, motion=self.motion, part=task.spread_part(noise), touched=task.touched,
                                touchable=touchable, uncorrected=self.before.deviation,
                                written=left - self.after.distance, tolerance=task.tolerance)  # fmt: skip
        except ConvergenceError:
            return None
        return replace(band, assumed=(*band.assumed, *describe_placement(noise, task.touched)))

    @cached_property
    def verdict(self) -> ToleranceVerdict:
        """Whether the 95 % band is within the tolerance: `word` for software, `sentence` for people."""
        return check_tolerance(
            self.task, self.status, self.error_band, before=self.before.distance, left=self.after.distance,
            known=self.motion is not None, failures=self.command.failures, failure=self.explain_failures(),
            position_mm=() if self.job is None else self.job.part.position_mm, corrected=self.strategy != "none",
            compensates=self.job is None or self.job.plan.inertia,
            traced=self.executed is not None and self.executed.known,
        )  # fmt: skip

    def explain_failures(self) -> str:
        """Describe failed waypoints and the limits they exceed, or the checks that failed; "" if solved."""
        failures, start = self.command.failures, self.task.start
        if not failures:
            return f"not confirmed: {'; '.join(self.breaches)}" if self.breaches else ""
        limits = sorted({name for text in failures.values() for name in text.split(", ")})
        word, stops, rows = "cannot be reached within the limits", "; ".join(limits[:LISTED]), sorted(failures)
        far = [k for k in rows if failures[k] != CORRECTION_LIMIT]
        if start is not None and start.cause and far:
            word, stops, rest, rows = "are out of reach", start.cause, len(rows) - len(far), far
            stops += f"; {rest} others need more correction than plan.max_correction_mm" if rest else ""
        elif not far:
            most = 1e3 * self.task.max_correction
            word, stops = f"need more correction than plan.max_correction_mm = {most:g}", "raise it"
        return (f"{len(rows)} of {len(self.task)} waypoints {word}, the first is waypoint {rows[0]} "
                f"({1e3 * self.task.nominal.arc_length[rows[0]]:.0f} mm along the path): {stops}")  # fmt: skip

    def summary(self) -> list[tuple[str, str]]:
        """Return the main results as pairs of name and text with units; the first is the headline."""
        band, nominal = self.error_band, self.task.nominal
        sizes = [f"rms {format_length(e.rms_deviation)}, greatest {format_length(e.max_deviation)}"
                 for e in (self.before, self.after)]  # fmt: skip
        widest = NO_BAND if self.status == "infeasible" else "not known: a robot within it has no equilibrium"
        if band is not None:
            widest = (f"{format_length(band.greatest)} at its widest, {format_length(band.whole)} over the whole path; "
                      f"the robot is {band.known.grade}")  # fmt: skip
        stops = self.explain_failures()
        return [
            ("plan", f"{self.name}: {self.status.replace('_', ' ')}, {self.strategy}, {self.robot.name}"),
            ("verdict", self.verdict.sentence),
            *([("stops", stops)] if stops else []),
            ("path", f"{len(self.task)} waypoints, {format_length(nominal.cutting_length)} of cut, "
                     f"{format_number(float(self.timing.time[-1]))} s"),
            ("deviation before", sizes[0]),
            ("deviation after", f"{sizes[1]} (as modelled, independent check)"),
            ("95 % band", widest),
            *([("notes", f"{len(self.notes)}, in plan.notes")] if self.notes else []),
        ]  # fmt: skip

    def columns(self) -> dict[str, Any]:
        """Return columns, a row per waypoint, named with units: path in base frame, time, joints, deviations, force."""
        task, band = self.task, self.error_band
        columns: dict[str, Any] = {"s_mm": task.nominal.arc_length * 1e3, "time_s": self.timing.time}
        columns |= self.robot.joint_columns(self.q)
        columns |= {f"{axis}_mm": task.programmed[:, k] * 1e3 for k, axis in enumerate("xyz")}
        columns |= {"deviation_before_mm": self.before.distance * 1e3, "deviation_after_mm": self.after.distance * 1e3}
        columns |= {} if band is None else {"band_p95_mm": band.radius * 1e3}
        return {**columns, "force_N": np.linalg.norm(task.wrench[:, :3], axis=1), "cut": task.cut}

    def curves(self) -> Curves:
        """Return the deviation along the path, without and with correction, and the 95 % band. [mm]."""
        s, cut, band = self.task.nominal.arc_length * 1e3, self.task.cut, self.error_band
        before, after = (np.where(cut, side.distance, np.nan) * 1e3 for side in (self.before, self.after))
        lines = [Curve("without correction", s, before, "before"), Curve("corrected, on the model", s, after, "after")]
        if band is not None:
            lines.append(Curve("95 % band", s, np.where(cut, band.along, np.nan) * 1e3, "band"))
        return Curves(self.name, "along the path [mm]", "deviation of the tip [mm]", tuple(lines),
                      (self.task.tolerance * 1e3, f"tolerance {self.task.tolerance * 1e3:g} mm"))  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of plan.json."""
        failures, between, (room, nearest) = self.command.failures, self.between, self.limit_room
        ways = {"joint_linear": between.joint, "cartesian_linear": between.cartesian}
        learned = None if self.task.law is None else self.task.law.learned  # force learned from measured parts
        summary: dict[str, Any] = {
            "schema": 1,
            "status": self.status,
            "verdict": self.verdict.describe(),
            "strategy": self.strategy,
            "name": self.name,
            "robot": self.robot.name,
            "robot_grade": self.robot.grade,
            "robot_sources": dict(self.robot.sources),
            **({} if self.job is None else {"part_frame": "touched_off" if self.job.part.touched_off else "absolute"}),
            "waypoints": len(self.task),
            "configuration": dict(self.task.configuration),
            "solve_time_s": round(self.command.solve_time, 4),
            **({"nlp": self.command.nlp} if self.command.nlp else {}),
            "error_before_mm": self.before.figures,
            "error_after_mm": self.after.figures,
            "between_waypoints_mm": {"max": between.max_deviation * 1e3}
            | {way: float(deviation.max(initial=0.0)) * 1e3 for way, deviation in ways.items()},
            **({} if self.executed is None else {"executed_mm": self.executed.describe()}),
            **({} if self.motion is None else {
                "inertia_mm": {"max": 1e3 * self.inertia, "compensated": self.task.inertia}}),
            **({} if self.error_band is None else self.error_band.describe()),
            "tilt_after_deg": {"max": float(np.degrees(self.after.max_tilt))},
            "within_tolerance": self.after.share_within(self.task.tolerance),
            "correction_mm": {"max": self.max_correction * 1e3},
            "margins": {
                "position_limit_deg": float(np.degrees(room)),
                "position_limit_joint": nearest,
                "velocity_ratio": self.timing.velocity_ratio,
                "acceleration_ratio": self.timing.acceleration_ratio,
            },
            "duration_s": float(self.timing.time[-1]),
            "judge": EXACT_EVALUATION,
            "checks": [check.describe() for check in self.checks if check.severity == STOP],
            "notes": [*self.reasons, *self.notes],
            "stops": list_stops([*self.reasons, *self.notes]),
            "made_by": describe_origin(),
        }  # fmt: skip
        if learned is not None:
            turn = np.degrees(learned.turn).tolist()
            summary["process_force"] = {"level": learned.level, "turn_deg": turn, "source": learned.source}
        start = self.task.start
        if start is not None and start.posture_choice is not None:
            program = {} if start.program is None else {"program": dict(start.program)}
            summary["posture"] = {**start.posture_choice.describe(), **program}
        if self.clearance is not None:
            scene = None if start is None else start.settings.scene
            summary["clearance"] = summarise_clearance(self.clearance, scene)
        if failures:
            summary["failures"] = [{"waypoint": k, "limit": limit} for k, limit in sorted(failures.items())]
        if self.status != "solved":
            summary["failure"] = self.explain_failures()
        return summary
