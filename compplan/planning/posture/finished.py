"""Finished postures of several presets, measured as plans are: a preset means the best by its own measure.

The graph prices time by joint rates alone, and deviation and motion at its stations; the finished ones are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from compplan.errors import InfeasibleError
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import Robot

#: Presets whose finished postures are measured beside that of a preset.
BESIDE = {"fast": ("smooth", "accurate"), "accurate": ("smooth", "fast"), "error_band": ("accurate", "smooth"),
          "smooth": ("accurate", "fast")}  # fmt: skip
#: Which of a posture's costs a preset makes least.
LEAST = {"fast": "driven_s", "accurate": "band_mm", "error_band": "band_mm", "smooth": "joint_travel_deg"}
#: Costs in words: what is best, what postures were, and what it means that they tie.
WORDS = {
    "driven_s": ("the fastest", "timed", "the programmed feed sets the time, not the posture"),
    "band_mm": ("that with the smallest 95 % band", "measured", "the posture does not set the 95 % band"),
    "joint_travel_deg": ("that with the least motion", "measured", "the path sets the motion, not the posture"),
}
#: Postures whose measures differ by less than this share tie.
TIED = 1e-3
#: Measures a finished posture of the robot that is searched, such as the time of its run. [s, mm, deg]
RobotMeasure = Callable[[Robot, PostureSummary], float]


@dataclass(frozen=True)
class Meter:
    """What finished postures are compared by: the cost's name with its unit, and how it is worked out."""

    cost: str
    measure: Callable[[PostureSummary], float]


def find_meter(robot: Robot, preset: str, measures: Mapping[str, RobotMeasure]) -> Meter | None:
    """Return the measure of a preset for a robot; None where it is not among the measures given.

    Args:
        robot: The robot.
        preset: The preset.
        measures: How costs of a finished posture are worked out, by their names.

    """
    cost = LEAST[preset]
    if cost not in measures:
        return None
    return Meter(cost, lambda stance: measures[cost](robot, stance))


def measure_posture(stance: PostureSummary, meter: Meter | None, name: str = "") -> PostureSummary:
    """Return a posture whose costs hold what it is compared by; as it is without a measure.

    Args:
        stance: The posture.
        meter: Measures it.
        name: What it is called among those compared, "" for none.

    """
    if meter is None:
        return stance
    value = meter.measure(stance)
    compared = {**stance.compared, name: value} if name else stance.compared
    return replace(stance, costs={**stance.costs, meter.cost: value}, compared=compared, compared_by=meter.cost)


def choose_finished(choose: Callable[[str], PostureSummary], preset: str, meter: Meter) -> PostureSummary:
    """Choose the best of the postures that several presets find.

    Args:
        choose: Finds the posture of a preset.
        preset: The preset that was asked for.
        meter: What they are compared by.

    Raises:
        InfeasibleError: If the preset that was asked for finds none.

    """
    found = [measure_posture(choose(preset), meter, preset)]
    for other in BESIDE[preset]:
        try:
            found.append(measure_posture(choose(other), meter, other))
        except InfeasibleError:
            continue
    compared = {name: value for stance in found for name, value in stance.compared.items()}
    best = min(found, key=lambda stance: stance.costs[meter.cost])
    return replace(best, settings=found[0].settings, compared=compared)


def describe_finished(stance: PostureSummary) -> str:
    """Say what the postures come to that were compared, "" where none were."""
    if len(stance.compared) < 2:
        return ""
    values, unit = stance.compared.values(), stance.compared_by.rpartition("_")[2]
    best, done, tied = WORDS[stance.compared_by]
    head = f"Preset {stance.settings.preset}: "
    if max(values) <= (1.0 + TIED) * min(values):
        said = f"{'take' if unit == 's' else 'come to'} {min(values):.4g} {unit}, within 0.1 %"
        return f"{head}the {len(values)} postures that were {done} {said}; {tied}."
    listed = ", ".join(f"{name} {value:.4g} {unit}" for name, value in stance.compared.items())
    return f"{head}{best} of the postures that were {done} is driven ({listed})."
