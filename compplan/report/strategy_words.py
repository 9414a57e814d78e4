"""Strategies in words, for charts, tables and sentences; the job and the result files call them by their names."""

from __future__ import annotations

from collections.abc import Iterable

from compplan.report.style import AFTER, BEFORE, NEUTRAL

WORDS = {
    "none": "no correction", "mirror": "mirror", "iterated_mirror": "repeated mirror",
    "nlp": "optimised (nlp)", "nlp_plain_posture": "optimised in the CAM posture",
    "secondary_encoder": "encoders behind the gears", "both_encoders": "encoders on both sides",
    "encoder_force": "force from encoders", "force_sensor_reduced": "force sensor (joints)",
    "force_sensor_full": "force sensor (all)", "online_pi": "online loop (PI)", "online_pid": "online loop (PID)",
    "first_part": "learned from a first part",
}  # fmt: skip


def name_strategy(name: str) -> str:
    """Name a strategy in a few words."""
    return WORDS.get(name, name.replace("_", " "))


def colour_strategies(names: Iterable[str], best: str) -> list[str]:
    """Return a colour a strategy: one for no correction, one for the best, grey for the others."""
    return [AFTER if name == best else BEFORE if name == "none" else NEUTRAL for name in names]
