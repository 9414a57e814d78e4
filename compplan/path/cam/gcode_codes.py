"""What the G codes of milling dialects do: modes, refused codes, codes that are noted or say nothing of the path."""

from __future__ import annotations

from collections.abc import Callable

from compplan.path.cam.gcode_state import State

REFUSED = {
    5.2: "NURBS", 6.2: "NURBS", 7.0: "lathe diameters", 12.0: "pocket cycles",
    13.0: "pocket cycles", 16.0: "polar coordinates", 32.0: "threading", 33.0: "threading", 33.1: "rigid tapping",
    34.0: "threading", 51.0: "scaling", 51.1: "mirroring", 65.0: "macro calls", 66.0: "modal macro calls",
    68.0: "coordinate rotation", 68.1: "coordinate rotation", 68.2: "tilted work planes",
    107.0: "cylindrical interpolation", 112.0: "polar interpolation",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
}
CYCLES = {73.0, 74.0, 76.0, *(float(number) for number in range(81, 90))}
#: Codes that say nothing about the programmed path.
SILENT = {4.0, 9.0, 15.0, 40.0, 49.0, 50.0, 50.1, 61.0, 61.1, 64.0, 67.0, 69.0, 80.0, 94.0, 96.0, 97.0}
NOTED = {
    10.0: "G10 offsets are not read",
    41.0: "cutter compensation (G41, G42) is not applied: the path is taken as programmed",
    43.0: "tool length compensation (G43) is not applied: the path is that of the tool tip",
    54.0: "work offsets (G54 ..) are not known: all coordinates are taken in one frame",
}
NOTED |= {41.1: NOTED[41.0], 42.0: NOTED[41.0], 42.1: NOTED[41.0], 43.1: NOTED[43.0], 44.0: NOTED[43.0]}
#: Greatest turn of the rotary axes between waypoints. [deg]
TURN_STEP = 1.0
PROBES = {31.0, 38.2, 38.3, 38.4, 38.5}
OFFSETS = {52.0, 92.0, 92.1, 92.2, 92.3}
#: Codes that take the coordinates of their block for themselves.
ALONE = OFFSETS | PROBES | {4.0, 10.0, 28.0, 30.0, 53.0, 153.0}
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
    98.0: _setter(retract_to_start=True), 99.0: _setter(retract_to_start=False),
}
