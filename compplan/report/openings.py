"""The first screens: of each page the verdict in a line, one picture, three figures, what to do next.

The plan's stands in `plan_opening`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.report.effect_words import describe_effect, name_effect
from compplan.report.page import Block, KeyFigure, Opening
from compplan.report.style import format_length, format_number, format_percent, format_set_length

if TYPE_CHECKING:
    from compplan.job.force_prediction import ForcePrediction
    from compplan.loop.campaign import PoseCampaign
    from compplan.loop.certificate import Certificate
    from compplan.loop.teach import Teaching
    from compplan.study.job_study import JobStudy

#: Strategies that differ by less than this share leave the same (assumed).
SAME = 0.05
#: What groups of uncertainties are called in a sentence.
GROUPS = {
    "wrench_level": "the level of the process force", "wrench_direction": "the direction of the process force",
    "joint_compliance": "the compliance of the joints", "link_compliance": "the compliance of the links",
    "geometry": "the geometry of the robot", "base": "the place of the part",
}  # fmt: skip


def join_names(names: Sequence[str]) -> str:
    """Join names as a sentence does."""
    plain = [name.replace("_", " ") for name in names]
    return plain[0] if len(plain) == 1 else f"{', '.join(plain[:-1])} and {plain[-1]}"


def open_comparison(
    left: Mapping[str, float], most_left: Mapping[str, float], tolerance: float, *, drawn: bool, picture: Block
) -> Opening:
    """Say which strategy to plan with, and what it brings on a robot like this one.

    Args:
        left: By strategy, the rms deviation that it leaves: median over drawn robots, or as modelled. [m]
        most_left: What it stays below on 95 of 100 of them, or the greatest deviation as modelled. [m]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        drawn: Whether the figures are of drawn robots.
        picture: The picture.
    """
    least = min(left.values())
    equals = [name for name, value in left.items() if value <= (1.0 + SAME) * least]
    best = "nlp" if "nlp" in equals else equals[-1]
    most = most_left[best]
    kept = most <= tolerance
    where = "on a typical robot like yours" if drawn else "on the robot as modelled"
    if "none" in equals:
        verdict = f"A correction brings nothing here: {format_length(least)} rms {where}, with and without it."
    else:
        without = f", without correction {format_length(left['none'])}" if "none" in left else ""
        others = [name for name in equals if name != best]
        verb = "leaves" if len(others) == 1 else "leave"
        alike = f" {join_names(others).capitalize()} {verb} the same." if others else ""
        verdict = f"Plan with {best}: it leaves {format_length(left[best])} rms {where}{without}.{alike}"
    figures = [
        KeyFigure(format_length(left[best]), f"rms deviation with {best}, {where}"),
        KeyFigure(format_length(most), f"what it stays below on 95 of 100 robots like yours; the tolerance is "
                  f"{format_set_length(tolerance)}", "good" if kept else "bad"),
    ]  # fmt: skip
    if "none" in left:
        figures.append(KeyFigure(format_length(left["none"]), "rms deviation without correction"))
    todo = f"Plan with it: compplan plan JOB, where the job says strategy = \"{best}\"."
    if not kept:
        todo = "Measure the robot (compplan campaign): what is not known of it matters more than the strategy."
    return Opening(verdict, "good" if kept else "unsure", figures, picture, todo)


def open_study(result: JobStudy, picture: Block) -> Opening:
    """Say how many parts keep the tolerance, and what to know better."""
    figures, tolerance = result.summary["strategies"], 1e-3 * result.summary["tolerance_mm"]
    best = min(figures, key=lambda name: figures[name]["rms_mm"]["mean"])
    entry = figures[best]
    share = float(entry["within_tolerance"])
    of = f"of 100 robots like this one {100 * share:.0f} keep {format_set_length(tolerance)}"
    verdict = f"With the strategy {best.replace('_', ' ')}, {of} over the whole part"
    if "none" in figures:
        verdict += f", without correction {100 * float(figures['none']['within_tolerance']):.0f}"
    numbers = [
        KeyFigure(f"{100 * share:.0f} of 100", "parts within the tolerance", "good" if share >= 0.95 else "bad"),
        KeyFigure(format_length(1e-3 * entry["rms_mm"]["mean"]), f"rms deviation with {best.replace('_', ' ')}, mean"),
        KeyFigure(format_length(1e-3 * entry["max_mm"]["p95"]), "greatest deviation, in 95 of 100"),
    ]
    todo = "More samples make the figures surer: --samples."
    if result.sensitivity is not None:
        shares = result.sensitivity.total[result.summary["sensitivity_of"]]
        group = result.sensitivity.groups[int(np.argmax(shares))]
        todo = f"Know {GROUPS.get(group, group.replace('_', ' '))} better: it makes most of what is left."
    return Opening(f"{verdict}.", "good" if share >= 0.95 else "unsure", numbers, picture, todo)


def open_diagnosis(verdict_table: Mapping[str, Any], gap: Mapping[str, float | None], picture: Block) -> Opening:
    """Say what is wrong with the robot, and how much of the gap that explains.

    Args:
        verdict_table: `verdict` of diagnosis.json.
        gap: `gap` of diagnosis.json.
        picture: The picture.
    """
    status, effects = verdict_table["status"], verdict_table["effects"]
    after, before = gap.get("held_out_after_rms_mm"), gap.get("held_out_before_rms_mm")
    first = "; ".join(describe_effect(effect) for effect in effects[:2])
    more = f"; and {len(effects) - 2} more" if len(effects) > 2 else ""
    verdicts = {
        "none": ("Nothing is wrong: what is left is noise of the measurement.", "good"),
        "unknown": ("Something is wrong that none of the known effects explains.", "unsure"),
        "explained": (f"Found: {first}{more}.", "good"),
    }
    verdict, tone = verdicts.get(status, (f"Found in part: {first}{more}. Something is left that nothing explains.",
                                          "unsure"))  # fmt: skip
    figures = []
    if before is not None and after is not None:
        figures = [KeyFigure(format_length(1e-3 * before), "rms error of the robot model before"),
                   KeyFigure(format_length(1e-3 * after), "of the updated one, on rows that it never saw",
                             "good" if after < 0.5 * before else "")]  # fmt: skip
    floor = gap.get("noise_floor_mm")
    figures += [] if not floor else [KeyFigure(format_length(1e-3 * floor), "noise of the measurement")]
    doubtful = [effect for effect in effects if effect.get("ambiguous_with")]
    todo = "Plan with the updated robot: compplan plan JOB --robot OUT/robot."
    if doubtful:
        rivals = join_names([name_effect(rival) for rival in doubtful[0]["ambiguous_with"][:2]])
        todo += f" To tell {name_effect(doubtful[0])} from {rivals}, measure what is listed below."
    elif status == "none":
        todo = "Nothing has to be done. Measure again after the next crash or service."
    return Opening(verdict, tone, figures, picture, todo)


def open_campaign(campaign: PoseCampaign, picture: Block) -> Opening:
    """Say what the poses bring."""
    choice = campaign.choice
    now, then = float(choice.greatest[0]), float(choice.greatest[-1])
    useful = len(choice.rows) if choice.enough is None else choice.enough
    verdict = f"{len(choice.rows)} poses narrow the 95 % band on this path from {format_length(now)} to "
    verdict += f"{format_length(then)}."
    tone = "good" if then < 0.8 * now else "unsure"
    if useful == 0:
        verdict, tone = "No further pose is worth measuring for this path.", "good"
    figures = [
        KeyFigure(format_length(now), "95 % band at its widest, now"),
        KeyFigure(format_length(then), f"after {len(choice.rows)} poses, if the robot is as its widths say", tone),
        KeyFigure(str(useful), "poses that are worth it"),
    ]
    todo = "Measure the poses in the order of the list into campaign.csv, then: compplan diagnose campaign.csv."
    return Opening(verdict, tone, figures, picture, todo)


def open_teaching(teaching: Teaching, picture: Block) -> Opening:
    """Say what the next part may be expected to be."""
    lesson = teaching.lesson
    if not lesson.taken:
        verdict = "The program stays as it is: the measured part does not say how to make the next one better."
        figures = [KeyFigure(format_length(lesson.rms), "rms deviation of the measured part")]
        return Opening(verdict, "unsure", figures, picture, "Measure more points, or another part, and learn again.")
    verdict = f"The next part should be off by {format_length(lesson.expected)} rms, this one was by "
    verdict += f"{format_length(lesson.rms)}."
    figures = [
        KeyFigure(f"{format_length(lesson.rms)} → {format_length(lesson.expected)}",
                  "rms deviation, measured and expected", "good"),
        KeyFigure(format_length(lesson.held_out), "left of it on stretches that the correction never saw"),
        KeyFigure(format_length(float(lesson.band_after.max())), "95 % band of the next part at its widest"),
    ]  # fmt: skip
    todo = "Cut the next part with the new program, measure it, and learn again with --robot OUT/robot."
    return Opening(verdict, "good", figures, picture, todo)


def open_certificate(certificate: Certificate) -> Opening:
    """Say what tolerance this robot keeps, and what to do first."""
    reached = [r for r in certificate.references if r.promise is not None]
    figures = [
        KeyFigure(format_length(r.promise.whole), f"95 % band on the {r.name}") for r in reached[:2] if r.promise
    ]
    accuracy = certificate.accuracy
    if accuracy is not None and accuracy.again:
        figures.append(KeyFigure(format_length(accuracy.pooled), "repeatability RP, as ISO 9283 defines it"))
    elif accuracy is not None:
        figures.append(KeyFigure(format_length(accuracy.rms), "rms error of the model over the log"))
    verdict = "On none of the reference paths a tolerance can be kept."
    bands = [(r.promise.whole, r.name) for r in reached if r.promise is not None]
    if bands:
        band, name = min(bands)
        verdict = f"After correction this robot keeps {format_length(band)} on the {name} with 95 %."
    steps = [str(step) for step in certificate.next_steps]
    return Opening(verdict, "good" if reached else "bad", figures[:3], None, steps[0] if steps else "")


def open_forces(found: ForcePrediction, summary: Mapping[str, Any], picture: Block) -> Opening:
    """Say what force the tool carries."""
    force, level = summary["force_N"], summary.get("uncertainty")
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    verdict = f"The tool carries up to {most}\u00a0N, {mean}\u00a0N on average in the cut."
    figures = [KeyFigure(f"{most}\u00a0N", "greatest force"), KeyFigure(f"{mean}\u00a0N", "mean force in the cut")]
    if level is not None:
        whence = "as the job says" if summary["uncertainty_stated"] else "assumed"
        figures.append(KeyFigure(f"± {100 * level:.0f}\u00a0%", f"of the level: one standard deviation, {whence}"))
    todo = "Plan with it: compplan plan JOB."
    if level is not None and not summary["uncertainty_stated"]:
        todo = "Measure the force of one cut and give the log: compplan forces JOB --log LOG.csv."
    return Opening(verdict, "" if found.fit is None else "good", figures, picture, todo)


def open_place(summary: Mapping[str, Any], picture: Block) -> Opening:
    """Say where the part should stand, and what that brings."""
    x, y, z = summary["part"]["position_mm"]
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    verdict = f"Put the part at X {x:g}, Y {y:g}, Z {z:g} mm"
    verdict += f", turned by {summary['part']['turn_deg']:g} deg" if summary["part"]["turn_deg"] else ""
    words = "what 95 % of the deviations stay below there, after correction"
    figures = [KeyFigure(f"{there:.3g}\u00a0mm", words, "good")]
    if here is None:
        verdict += "; from where the job has it the path cannot be followed."
    else:
        verdict += f": the deviation that is left falls to {format_percent(summary['ratio'])}."
        figures.append(KeyFigure(f"{here['p95']:.3g}\u00a0mm", "the same where the job has it"))
    figures.append(KeyFigure(f"{x:g}, {y:g}, {z:g}", "position_mm of [part]"))
    return Opening(verdict, "good", figures, picture, "Write position_mm into [part] of the job and plan again.")


def open_identification(summary: Mapping[str, Any], picture: Block | None) -> Opening:
    """Say how far the fitted robot model is from the measurements."""
    gap = summary["gap"]
    before, after = 1e-3 * gap["held_out_before_rms_mm"], 1e-3 * gap["held_out_after_rms_mm"]
    better = after < before
    verdict = f"The fitted robot model is off by {format_length(after)} rms on poses that it never saw, before by "
    written = sum(1 for entry in summary["parameters"] if entry["written"])
    figures = [
        KeyFigure(f"{format_length(before)} → {format_length(after)}", "rms error on poses that it never saw",
                  "good" if better else "bad"),
        KeyFigure(str(written), "values are written to the robot folder"),
        KeyFigure(str(summary["poses"]), f"poses, {summary['rows']} rows"),
    ]  # fmt: skip
    todo = "Plan with it: compplan plan JOB --robot OUT/robot." if better else "Measure more poses: compplan campaign."
    return Opening(f"{verdict}{format_length(before)}.", "good" if better else "bad", figures, picture, todo)
