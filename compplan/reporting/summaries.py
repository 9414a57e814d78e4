"""The first screens: of each page the verdict in a line, one picture, three figures, what to do next.

The plan's stands in `plan_opening`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.io.notes import list_stops
from compplan.planning.tolerance_verdict import MEASURE
from compplan.reporting.diagnosis_text import reaches_noise
from compplan.reporting.effect_text import describe_effect, name_effect
from compplan.reporting.page import Block, KeyFigure, Summary
from compplan.reporting.strategy_text import name_strategy
from compplan.reporting.style import format_mm, format_mm_change, format_number, format_percent, format_set_length

if TYPE_CHECKING:
    from compplan.job.force_prediction import ForcePrediction
    from compplan.learning.campaign import PoseCampaign
    from compplan.learning.part import LearnedPart
    from compplan.studies.job_study import JobStudy

#: Strategies that differ by less than this share leave the same (assumed).
SAME = 0.05
#: What groups of uncertainties are called in a sentence.
GROUPS = {
    "wrench_level": "the level of the process force", "wrench_direction": "the direction of the process force",
    "robot": "the uncertainty of the robot", "link_share": "the link share", "part": "the place of the part",
}  # fmt: skip


def join_names(names: Sequence[str]) -> str:
    """Join names as a sentence does."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def list_equals(left: Mapping[str, float]) -> list[str]:
    """List the strategies that leave least, or no more than a small share beyond that."""
    bound = (1.0 + SAME) * min(left.values())
    return [name for name, value in left.items() if value <= bound]


def choose_best(left: Mapping[str, float]) -> str:
    """Choose the strategy to plan with by what each leaves: of equals the product's own."""
    equals = list_equals(left)
    return "nlp" if "nlp" in equals else equals[-1]


def open_comparison(
    left: Mapping[str, float], most_left: Mapping[str, float], tolerance: float, *, drawn: bool, picture: Block
) -> Summary:
    """Say which strategy to plan with, and what it brings on a robot like this one.

    Args:
        left: By strategy, the rms deviation that it leaves: median over drawn robots, or as modelled. [m]
        most_left: What it stays below on 95 of 100 of them, or the greatest deviation as modelled. [m]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        drawn: Whether the figures are of drawn robots.
        picture: The picture.
    """
    best, equals = choose_best(left), list_equals(left)
    most = most_left[best]
    kept = most <= tolerance
    where = "on a typical robot like yours" if drawn else "on the robot as modelled"
    if "none" in equals:
        verdict = f"A correction brings nothing here: {format_mm(left[best])} rms {where}, with and without it."
    else:
        others = [name_strategy(name) for name in equals if name != best]
        verb = "leaves" if len(others) == 1 else "leave"
        alike = f"; {join_names(others)} {verb} as little" if others else ""
        verdict = f"Plan with the strategy {name_strategy(best)}{alike}."
    stays = "it stays below that on 95 of 100 robots like yours" if drawn else "greatest deviation"
    figures = [
        KeyFigure(format_mm(left[best]), f"rms deviation with it, {where}"),
        KeyFigure(format_mm(most), f"{stays}; the tolerance is {format_set_length(tolerance)}",
                  "good" if kept else "bad"),
    ]  # fmt: skip
    if "none" in left:
        figures.append(KeyFigure(format_mm(left["none"]), "rms deviation without correction"))
    todo = f'Plan with it: compplan plan JOB, where the job says strategy = "{best}".'
    if not kept:
        todo = f"{MEASURE} Its uncertainty matters more than the strategy."
    return Summary(verdict, "good" if kept else "unsure", figures, picture, todo)


def open_study(result: JobStudy, picture: Block) -> Summary:
    """Say how many parts keep the tolerance, and what to know better."""
    figures, tolerance = result.summary["strategies"], 1e-3 * result.summary["tolerance_mm"]
    best = min(figures, key=lambda name: figures[name]["rms_mm"]["mean"])
    entry = figures[best]
    share = float(entry["within_tolerance"])
    count = f"{100 * share:.0f}" if share else "None"
    tone = "good" if share >= 0.95 else "unsure" if share >= 0.5 else "bad"
    even = " even" if share < 0.5 else ""
    verdict = f"{count} of 100 parts keep {format_set_length(tolerance)},{even} with the best strategy"
    numbers = [
        KeyFigure(f"{100 * share:.0f} of 100", "parts within the tolerance over the whole path", tone),
        KeyFigure(format_mm(1e-3 * entry["rms_mm"]["mean"]), "rms deviation with the best strategy, mean of all"),
        KeyFigure(format_mm(1e-3 * entry["max_mm"]["p95"]), "95 of 100 parts are nowhere farther off than that"),
    ]
    todo = "More samples narrow the intervals: --samples."
    if result.sensitivity is not None:
        shares = result.sensitivity.total[result.summary["sensitivity_of"]]
        group = result.sensitivity.groups[int(np.argmax(shares))]
        todo = f"Measure {GROUPS.get(group, group.replace('_', ' '))}: it makes most of the deviation that is left."
    return Summary(f"{verdict}: {name_strategy(best)}.", tone, numbers, picture, todo)


def open_diagnosis(
    verdict_table: Mapping[str, Any], gap: Mapping[str, float | None], delivered: str, picture: Block,
    small: float = 0.0, *, listed: bool = True,
) -> Summary:  # fmt: skip
    """Say what is wrong with the robot, and how much of the gap that explains.

    Args:
        verdict_table: `verdict` of diagnosis.json.
        gap: `gap` of diagnosis.json.
        delivered: Kind of the robot folder that is written: "nominal" where nothing predicts better.
        picture: The picture.
        small: Share of the gap that small errors everywhere carry.
        listed: Whether poses to measure next stand below.
    """
    status, effects = verdict_table["status"], verdict_table["effects"]
    after, before = gap.get("held_out_after_rms_mm"), gap.get("held_out_before_rms_mm")
    first = "; ".join(describe_effect(effect) for effect in effects[:2])
    more = f"; and {len(effects) - 2} more" if len(effects) > 2 else ""
    taken_up = reaches_noise(gap, delivered)
    alone = " by itself, but calibration takes it up to the noise" if taken_up else ""
    verdicts = {
        "none": ("Nothing is wrong: what is left is noise of the measurement.", "good"),
        "unknown": (f"No known effect explains the gap{alone}.", "unsure"),
        "calibrated": ("The robot was not calibrated: many small errors, none of them a cause by itself.", "good"),
        "explained": (f"Found: {first}{more}.", "good"),
    }
    doubtful = [effect for effect in effects if effect.get("ambiguous_with")]
    if doubtful:
        rivals = join_names([name_effect(rival) for rival in doubtful[0]["ambiguous_with"][:2]])
        verdicts["explained"] = (f"Found, but not for certain: {first}{more}.", "unsure")
    floor = gap.get("noise_floor_mm")
    left = "A part of the gap is not explained."
    if taken_up:
        left = "The rest has no name, but calibration takes it up to the noise."
    if small > 0.5:
        left = f"Most of the gap is small errors, as of a robot that was not calibrated. {left}"
    verdict, tone = verdicts.get(status, (f"Found in part: {first}{more}. {left}", "unsure"))
    figures = []
    if before is not None and after is not None:
        figures = [KeyFigure(format_mm(1e-3 * before), "rms error of the robot model before"),
                   KeyFigure(format_mm(1e-3 * after), "rms error of the updated one; both on rows not used for the fit",
                             "good" if after < 0.5 * before else "")]  # fmt: skip
    figures += [] if not floor else [KeyFigure(format_mm(1e-3 * floor), "noise of the measurement")]
    todo = "Plan with the updated robot: compplan plan JOB --robot OUT/robot."
    more_poses = "Measure more poses, as listed below" if listed else "Measure more poses, other ones than these"
    if doubtful:
        later = f" Until then: {todo}" if delivered != "nominal" else ""
        todo = f"{more_poses}: {rivals} would explain the measurements as well.{later}"
    elif delivered == "nominal" and status != "none":
        todo = f"Nothing predicts better than the robot folder as it was. {more_poses}."
    elif status == "none":
        todo = "Nothing has to be done. Measure again after the next crash or service."
    return Summary(verdict, tone, figures, picture, todo)


def open_campaign(campaign: PoseCampaign, picture: Block) -> Summary:
    """Say what the poses bring."""
    choice = campaign.choice
    now, then = float(choice.greatest[0]), float(choice.greatest[-1])
    useful = len(choice.rows) if choice.enough is None else choice.enough
    place = campaign.equipment.place
    verdict = f"{useful} poses are enough: they narrow the 95 % band {place} from {format_mm(now)} to "
    verdict += f"{format_mm(float(choice.greatest[useful]))}."
    tone = "good" if then < 0.8 * now else "unsure"
    if useful == 0:
        verdict, tone = f"No further pose is worth measuring: none narrows the band {place}.", "good"
    figures = [
        KeyFigure(format_mm(now), "95 % band at its widest point, now"),
        KeyFigure(format_mm(then), f"expected after all {len(choice.rows)} poses", tone),
        KeyFigure(str(useful), "poses that are worth measuring; each further one brings less than 0.5 %"),
    ]
    todo = "Measure the poses in the order of the list and fill in campaign.csv. Then: compplan diagnose campaign.csv "
    todo += "--robot ROBOT --out updated."
    return Summary(verdict, tone, figures, picture, todo)


def open_learning(teaching: LearnedPart, picture: Block) -> Summary:
    """Say what the next part may be expected to be."""
    lesson = teaching.lesson
    if not lesson.taken:
        verdict = "The program stays as it is: the measured part does not improve the next one."
        figures = [KeyFigure(format_mm(lesson.rms), "rms deviation of the measured part")]
        return Summary(verdict, "unsure", figures, picture, "Measure more points, or another part, and learn again.")
    verdict = "The new program should make the next part better."
    figures = [
        KeyFigure(format_mm_change(lesson.rms, lesson.expected),
                  "rms deviation, measured on this part and expected of the next", "good"),
        KeyFigure(format_mm(lesson.held_out), "checked: left on stretches not used for the correction"),
        KeyFigure(format_mm(float(lesson.band_after.max())), "95 % band of the next part at its widest"),
    ]  # fmt: skip
    todo = "Cut the next part with the new program, measure it, and learn again with --robot OUT/robot."
    return Summary(verdict, "good", figures, picture, todo)


def open_forces(found: ForcePrediction, summary: Mapping[str, Any], picture: Block) -> Summary:
    """Say what force the tool carries."""
    force, level = summary["force_N"], summary.get("uncertainty")
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    sizes = np.abs(found.local)
    along, across = sizes[:, 2].max(initial=0.0), np.hypot(sizes[:, 0], sizes[:, 1]).max(initial=0.0)
    about = np.abs(np.einsum("ni,ni->n", found.wrench[:, 3:], found.nominal.axis)).max(initial=0.0)
    verdict = (f"The force on the tool is at most {most}\u00a0N: {format_number(float(along))}\u00a0N along its axis, "
               f"{format_number(float(across))}\u00a0N across")  # fmt: skip
    verdict += f"; torque {format_number(float(about))}\u00a0N\u00a0m." if about > 1e-3 else "."
    figures = [KeyFigure(f"{most}\u00a0N", "greatest force"), KeyFigure(f"{mean}\u00a0N", "mean force in the cut")]
    if level is not None:
        whence = "as the job says" if summary["uncertainty_stated"] else "assumed"
        words = f"uncertainty of these forces, one standard deviation, {whence}"
        figures.append(KeyFigure(f"± {100 * level:.0f}\u00a0%", words))
    todo = "Plan with it: compplan plan JOB."
    if level is not None and not summary["uncertainty_stated"]:
        todo = "Measure the force of one cut and give the log: compplan forces JOB --log LOG.csv."
    stops = list_stops(summary["notes"])
    if stops:
        return Summary(verdict, "bad", figures, picture, "Settle what is listed before the machine moves.", stops)
    return Summary(verdict, "" if found.fit is None else "good", figures, picture, todo)


def open_place(summary: Mapping[str, Any], picture: Block) -> Summary:
    """Say where the part should stand, and what that brings."""
    x, y, z = summary["part"]["position_mm"]
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    verdict = f"Put the part at X {x:g}, Y {y:g}, Z {z:g} mm"
    verdict += f", turned by {summary['part']['turn_deg']:g} deg" if summary["part"]["turn_deg"] else ""
    words = "95 % of the remaining deviations are smaller there"
    figures = [KeyFigure(f"{there:.3g}\u00a0mm", words, "good")]
    if here is None:
        verdict += "; at the job's place the path cannot be followed."
    else:
        verdict += "."
        figures.append(KeyFigure(f"{here['p95']:.3g}\u00a0mm", "the same at the job's place"))
        less = format_percent(1.0 - summary["ratio"])
        figures.append(KeyFigure(less, "less deviation than at the job's place", "good"))
    todo = f"Write position_mm = [{x:g}, {y:g}, {z:g}] into [part] of the job and plan again."
    return Summary(verdict, "good", figures, picture, todo)


def open_identification(summary: Mapping[str, Any], picture: Block | None) -> Summary:
    """Say how far the fitted robot model is from the measurements."""
    gap = summary["gap"]
    before, after = 1e-3 * gap["held_out_before_rms_mm"], 1e-3 * gap["held_out_after_rms_mm"]
    better = after < before
    verdict = "The fit makes the robot model no better."
    if better:
        verdict = f"The fitted robot model is {format_number(before / after, 2)} times closer to the measurements."
    written = sum(1 for entry in summary["parameters"] if entry["written"])
    figures = [
        KeyFigure(format_mm_change(before, after), "rms error before and after, on poses not in the fit",
                  "good" if better else "bad"),
        KeyFigure(str(written), "values are written to the robot folder"),
        KeyFigure(str(summary["poses"]), f"poses, {summary['rows']} rows"),
    ]  # fmt: skip
    todo = "Plan with it: compplan plan JOB --robot OUT/robot." if better else MEASURE
    return Summary(verdict, "good" if better else "bad", figures, picture, todo)
