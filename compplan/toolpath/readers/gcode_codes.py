"""What the G codes of milling dialects do: modes, refused codes, codes that are noted or say nothing of the path."""

from __future__ import annotations

import re
from collections.abc import Callable

from compplan.toolpath.readers.gcode_state import State

REFUSED = {
    5.2: "NURBS", 6.2: "NURBS", 7.0: "lathe diameters", 12.0: "pocket cycles",
    13.0: "pocket cycles", 32.0: "threading", 33.0: "threading", 33.1: "rigid tapping",
    34.0: "threading", 66.0: "modal macro calls", 66.1: "modal macro calls", 68.1: "coordinate rotation",
    68.3: "tilted work planes by the tool axis", 68.4: "tilted work planes on top of each other",
    107.0: "cylindrical interpolation", 112.0: "polar interpolation", 268.0: "tilted work planes of Haas",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation", 54.4: "workpiece setting errors",
}
CYCLES = {73.0, 74.0, 76.0, *(float(number) for number in range(81, 90))}
#: Codes that say nothing about the programmed path.
SILENT = {4.0, 9.0, 40.0, 61.0, 61.1, 64.0, 67.0, 96.0, 97.0, 113.0, 269.0}
NOTED = {
    10.0: "G10 offsets are not read",
    43.0: "tool length compensation (G43) is not applied: the path is that of the tool tip",
    22.0: "limits of the working space (G22) are not read",
    29.0: "G29 (probing) is left out; where it ended is not known",
}
NOTED |= {43.1: NOTED[43.0], 44.0: NOTED[43.0]}
#: Codes that compensate the radius of the cutter.
COMPENSATED = frozenset({41.0, 41.1, 42.0, 42.1})
#: Greatest turn of the rotary axes between waypoints. [deg]
TURN_STEP = 1.0
#: Temperatures of hot end and bed: files of printers have them; their lengths are millimetres, E is the extruder.
PRINTER = re.compile(
    r"^[ \t]*(?:N\d+[ \t]*)?M(?:104|109|140|190)[ \t]*(?:T\d+[ \t]*)?[SR][ \t]*\d", re.MULTILINE | re.IGNORECASE
)
PROBES = {31.0, 38.2, 38.3, 38.4, 38.5}
OFFSETS = {52.0, 92.0, 92.1, 92.2, 92.3}
#: Codes that turn, scale or tilt the frame.
FRAMES = frozenset({50.0, 50.1, 51.0, 51.1, 53.1, 53.6, 68.0, 68.2, 69.0, 254.0, 255.0})
#: Codes that take the coordinates of their block for themselves.
ALONE = OFFSETS | PROBES | FRAMES | {4.0, 10.0, 22.0, 28.0, 30.0, 43.1, 53.0, 153.0}
#: Codes under which X Y Z are the tip in the part frame however rotary axes stand, and those that end it.
TIP_ON, TIP_OFF = frozenset({43.4, 43.5, 234.0}), frozenset({43.0, 44.0, 49.0})
#: Codes that act before all others of their block, and in this order; motion acts last.
FIRST = (20.0, 21.0, 70.0, 71.0, 90.0, 91.0, 17.0, 18.0, 19.0, 93.0, 94.0, 95.0, 80.0, 98.0, 99.0)
RANKS = {code: rank - len(FIRST) for rank, code in enumerate(FIRST)} | dict.fromkeys(ALONE, 2)
RANKS |= dict.fromkeys((0.0, 1.0, 2.0, 3.0, *CYCLES), 1)
#: Codes of which a block may hold one.
CONTRARY = (
    frozenset({20.0, 21.0}), frozenset({90.0, 91.0}), frozenset({17.0, 18.0, 19.0}), frozenset({93.0, 94.0, 95.0}),
    frozenset({98.0, 99.0}), frozenset({0.0, 1.0, 2.0, 3.0, *CYCLES}),
)
#: Work offsets of Haas: G110 is G154 P1.
HAAS_OFFSETS = frozenset({110.0, 111.0, *(float(number) for number in range(114, 130))})
#: Greatest number of turns of one helix.
MOST_TURNS = 10_000


def _setter(**changes: object) -> Callable[[State], None]:
    def change(state: State) -> None:
        for name, value in changes.items():
            setattr(state, name, value)

    return change


MODES: dict[float, Callable[[State], None]] = {
    17.0: _setter(plane=17), 18.0: _setter(plane=18), 19.0: _setter(plane=19),
    90.0: _setter(incremental=False), 91.0: _setter(incremental=True),
    90.1: _setter(centres="absolute", centres_stated=True), 91.1: _setter(centres="incremental", centres_stated=True),
    93.0: _setter(feed_mode=93), 94.0: _setter(feed_mode=94), 95.0: _setter(feed_mode=95),
    15.0: _setter(polar=False), 16.0: _setter(polar=True),
    98.0: _setter(retract_to_start=True), 99.0: _setter(retract_to_start=False),
}
