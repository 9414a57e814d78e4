"""The result of a diagnosis: a frozen record, the source of reports, charts and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.results.delivery import Delivery
from compplan.diagnosis.results.posterior import state_change
from compplan.diagnosis.results.repeats import RepeatCheck, check_repeats
from compplan.diagnosis.results.verdict import CALIBRATED, Finding, Verdict
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled import RevisedProbabilities
from compplan.effects.linearization import Place
from compplan.effects.signature import plain
from compplan.io.display import MOST_LISTED, Curve, Curves, Shown
from compplan.io.quantities import format_length
from compplan.measurement.registration import Registration
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty


@dataclass(frozen=True)
class Candidate:
    """One effect alone: its place, its rms error on held-out rows [m], and its probability."""

    place: Place
    held_out: float
    probability: float


@dataclass(frozen=True)
class Gap:
    """Root mean square 3D distances, outliers left out. [m]"""

    before: float  #: Nominal robot, registered if requested.
    after: float  #: Updated robot.
    held_out_before: float  #: Nominal robot over the rows that are held out in turn.
    held_out_after: float  #: Updated robot, on rows left out of its fit.
    noise_floor: float  #: Rms distance that a perfect model leaves.


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """Result of the diagnosis of a campaign.

    Attributes:
        robot: The nominal robot.
        updated: The updated robot: URDF, springs and effects. The nominal one if nothing was found.
        fit: The fit: campaign, exact effects, linearization, normal equations with all evaluated models.
        revised: Effects re-estimated with a term for unmodelled causes; names and shares come from this posterior.
        verdict: Status and named effects.
        gap: Distance between model and measurements, before and after.
        candidates: Effects one by one, ranked.
        residual_before: Measured minus expected by the nominal robot (registered if requested), base axes, all rows.
            (n, 3) [m]
        residual_after: Measured minus expected by the updated robot, base axes, all rows. Shape (n, 3). [m]
        registration: Frames fitted with the updated robot, or None.
        outliers: Rows reported as outliers.
        delivery: The delivered robot model; every figure is computed with it.
        equations: Normal equations of the delivered model's posterior, gear waves included.
        sizes: Covariance of the parameters of the named effects, given that these are present.
        noise: Sources of the noise floor.
    """

    robot: Robot
    updated: Robot
    fit: Fit
    revised: RevisedProbabilities
    verdict: Verdict
    gap: Gap
    candidates: tuple[Candidate, ...]
    residual_before: Array
    residual_after: Array
    registration: Registration | None
    outliers: NDArray[np.int_]
    delivery: Delivery
    equations: NormalEquations
    sizes: Uncertainty
    noise: str

    @cached_property
    def repeats(self) -> RepeatCheck | None:
        """Repeated poses that scatter beyond the stated sigma, outliers left out; None where none do."""
        good = self.fit.problem.campaign.usable.copy()
        good[self.outliers] = False
        return check_repeats(self.fit.at, np.where(good[:, None], self.residual_after, np.nan))

    @property
    def points(self) -> Array:
        """Measured points, base frame; in rows without a position the predicted point. Shape (n, 3). [m]"""
        campaign, frames = self.fit.problem.campaign, self.registration
        place = campaign.position
        if frames is not None:
            place = (place - frames.base[:3, 3]) @ frames.base[:3, :3]
        return np.where(campaign.measured[:, None], place, self.fit.at.point)

    def summary(self) -> list[tuple[str, str]]:
        """Return the summary: causes, and the gap before and after."""
        found, gap, rows = self.verdict.findings, self.gap, []
        for finding in found[:MOST_LISTED]:
            place = " ".join(str(part) for part in finding.effect.place[1:] if part is not None)
            moved = f", moves the tip {format_length(finding.explained)}" if np.isfinite(finding.explained) else ""
            rows.append((finding.effect.name, f"{place or 'robot'}: probability {finding.probability:.2f}{moved}"))
        more = [("further causes", str(len(found) - MOST_LISTED))] if len(found) > MOST_LISTED else []
        words = {"none": "nothing is wrong", CALIBRATED: "not calibrated, many small errors"}
        status = words.get(self.verdict.status, self.verdict.status.replace("_", " "))
        return [
            ("diagnosis", f"{status}, {self.robot.name}, {len(self.residual_before)} rows"),
            *rows, *more,
            ("gap", f"{format_length(gap.before)} before, {format_length(gap.after)} after (rms)"),
            ("on rows left out of the fit",
             f"{format_length(gap.held_out_before)} before, {format_length(gap.held_out_after)} after"),
            ("measurement noise", f"{format_length(gap.noise_floor)}, from {self.noise}"), *self.list_remarks(),
        ]  # fmt: skip

    def list_remarks(self) -> list[tuple[str, str]]:
        """Return the rows of the summary that follow the gap: effects not named, repeated poses, outliers."""
        beyond = [finding for finding in self.verdict.doubtful if finding.beyond]
        return [
            *(("not named", f"{finding.effect.name}: {finding.beyond}") for finding in beyond[:MOST_LISTED]),
            *([] if self.repeats is None else [("repeated poses", self.repeats.sentence)]),
            *([("outliers", f"{len(self.outliers)} rows left out")] if len(self.outliers) else []),
        ]  # fmt: skip

    def columns(self) -> dict[str, Any]:
        """Return a table of the measured rows: joints, distance before and after, outlier flag."""
        campaign = self.fit.problem.campaign
        columns: dict[str, Any] = {"run": campaign.run, **self.robot.joint_columns(campaign.q)}
        for name, residual in (("before", self.residual_before), ("after", self.residual_after)):
            columns |= {f"d{axis}_{name}_mm": residual[:, k] * 1e3 for k, axis in enumerate("xyz")}
            columns[f"distance_{name}_mm"] = np.linalg.norm(residual, axis=1) * 1e3
        return {**columns, "outlier": np.isin(np.arange(len(campaign)), self.outliers)}

    def curves(self) -> Curves:
        """Return the distance between measured and predicted point in every row, before and after the update. [mm]"""
        rows = np.arange(1.0, len(self.residual_before) + 1.0)
        before, after = (np.linalg.norm(r, axis=1) * 1e3 for r in (self.residual_before, self.residual_after))
        lines = (Curve("before", rows, before, "before"), Curve("after", rows, after, "after"))
        return Curves(f"{self.robot.name}: measured minus expected", "row of the log", "distance [mm]", lines,
                      (self.gap.noise_floor * 1e3, "measurement noise"))  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return the content of diagnosis.json."""
        return self.to_table()

    def to_table(self, extra: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the content of diagnosis.json; `extra` adds or replaces keys (where, next_measurement)."""
        structure = self.verdict.structure
        table: dict[str, Any] = {
            "schema": 1,
            "verdict": {
                "status": self.verdict.status,
                "effects": [
                    {**finding_table(f), **state_change(self.robot, f.effect, self.sizes)}
                    for f in self.verdict.findings
                ],
                "doubtful": [finding_table(f) for f in self.verdict.doubtful],
                "minor": [finding_table(f) for f in self.verdict.minor],
            },
            "gap": {
                "before_rms_mm": _mm(self.gap.before),
                "after_rms_mm": _mm(self.gap.after),
                "held_out_before_rms_mm": _mm(self.gap.held_out_before),
                "held_out_after_rms_mm": _mm(self.gap.held_out_after),
                "noise_floor_mm": _mm(self.gap.noise_floor),
                "noise_source": self.noise,
                **({} if self.repeats is None else {"repeats": self.repeats.to_json()}),
            },
            "structure_left": {
                "present": structure.left,
                "rms_mm": _mm(structure.rms),
                "log_evidence": round(structure.gain, 2),
                "background_rms_mm": _mm(structure.background),
                "explained_rms_mm": _mm(structure.explained),
                "depends_on": [dependence_table(f) for f in structure.dependences],
            },
            "delivered": {"kind": self.delivery.kind, "held_out_rms_mm": _mm(self.delivery.held.rms)},
            "calibration": {"explained_rms_mm": _mm(structure.background)},
            "outliers": [int(row) for row in self.outliers],
            "where": {},
            "candidates": [
                {**place_table(c.place), "held_out_rms_mm": _mm(c.held_out), "probability": round(c.probability, 4)}
                for c in self.candidates
            ],
            "next_measurement": [],
        }
        return {**table, **(extra or {})}


def place_table(place: Place) -> dict[str, str | None]:
    """Return name, joint and axis in the format of diagnosis.json."""
    return {"effect": place[0], "joint": place[1], "axis": place[2]}


def dependence_table(finding: Finding) -> dict[str, Any]:
    """Return the dependence of an unexplained error in the format of diagnosis.json."""
    return {
        "joint": finding.effect.joint,
        "driver": finding.effect.axis,
        "probability": round(finding.probability, 4),
        "rms_mm": _mm(finding.explained),
    }


def finding_table(finding: Finding) -> dict[str, Any]:
    """Return a named effect in the format of diagnosis.json."""
    return {
        **place_table(finding.effect.place),
        "probability": round(finding.probability, 4),
        "parameters": {key: plain(value) for key, value in finding.effect.parameters.items()},
        "ambiguous_with": [place_table(r.place) for r in finding.rivals if r.alike],
        "explained_rms_mm": _mm(finding.explained),
        "log_odds": round(finding.margin, 2),
        "evidence": {} if finding.evidence is None else finding.evidence.to_table(),
        **({"beyond": finding.beyond} if finding.beyond else {}),
        "nearest": [{**place_table(r.place), "share": round(r.share, 4)} for r in finding.rivals[:3]],
    }


def _mm(value: float) -> float:
    return round(float(value) * 1e3, 5)
