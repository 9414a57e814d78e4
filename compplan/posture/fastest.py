"""The fastest posture: the graph prices time by joint rates alone, so finished postures are timed and compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from compplan.errors import InfeasibleError
from compplan.posture.summary import Stance
from compplan.robot import Robot

#: Presets whose postures are timed beside that of `fast`.
BESIDE = ("smooth", "accurate")
#: Postures whose times differ by less than this share tie.
TIED = 1e-3
#: Times the run along a posture of the robot that is searched, limits of its joints and programmed feed held. [s]
Clock = Callable[[Stance], float]
RobotClock = Callable[[Robot, Stance], float]


def time_stance(stance: Stance, clock: Clock | None, name: str = "") -> Stance:
    """Return a posture whose costs say how long the run along it takes; as it is without a clock.

    Args:
        stance: The posture.
        clock: Times it.
        name: What it is called among those compared, "" for none.

    """
    if clock is None:
        return stance
    time = clock(stance)
    timed = {**stance.timed, name: time} if name else stance.timed
    return replace(stance, costs={**stance.costs, "driven_s": time}, timed=timed)


def choose_fastest(choose: Callable[[str], Stance], clock: Clock) -> Stance:
    """Choose the fastest of the postures that several presets find.

    Args:
        choose: Finds the posture of a preset.
        clock: Times a posture.

    Raises:
        InfeasibleError: If the preset `fast` finds none.

    """
    found = [time_stance(choose("fast"), clock, "fast")]
    for preset in BESIDE:
        try:
            found.append(time_stance(choose(preset), clock, preset))
        except InfeasibleError:
            continue
    timed = {name: time for stance in found for name, time in stance.timed.items()}
    best = min(found, key=lambda stance: stance.costs["driven_s"])
    return replace(best, settings=found[0].settings, timed=timed)


def describe_fastest(stance: Stance) -> str:
    """Say how long the postures take that were compared, "" where none were."""
    if len(stance.timed) < 2:
        return ""
    times = stance.timed.values()
    if max(times) <= (1.0 + TIED) * min(times):
        return (f"Preset fast: the {len(stance.timed)} postures that were timed take {min(times):.4g} s, within 0.1 %; "
                "the programmed feed sets the time, not the posture.")  # fmt: skip
    listed = ", ".join(f"{name} {time:.4g} s" for name, time in stance.timed.items())
    return f"Preset fast: the fastest of the postures that were timed is driven ({listed})."
