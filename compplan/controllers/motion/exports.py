"""Columns of logs as the loggers of controllers name them.

| log | time | executed joints | commanded joints | torque |
|---|---|---|---|---|
| RTDE client (Universal Robots) | timestamp, s | actual_q_0 .., rad | target_q_0 .., rad | target_moment_0 .., Nm |
| EGM message (ABB) | header.tm, ms | feedBack.joints.joints_0 .., deg | planned.joints.joints_0 .. | |
| motion_program_logger (ABB) | timestamp, s | J1 .., deg | | |
| RSI telegram (KUKA) | IPOC, ms | AIPos.A1 .., deg | ASPos.A1 .., deg | GearTorque.A1 .., Nm |
| channels of a trace (KUKA), as CSV | time_s | AxisPos_Act1 .., deg | AxisPos_CmdIpo1 .., deg | |

Names of nested fields may be joined by `.`, `_` or `/`, numbers of elements stand in brackets or behind one of those.
Such joints are counted as the controller counts them.
"""

from __future__ import annotations

import re

#: Fields that hold a time, and those that hold a number a joint: our name, and what their numbers count from.
TIMES = {"timestamp": "time_s", "header_tm": "time_ms", "ipoc": "time_ms"}
JOINTS = (
    (re.compile(r"(actual_q|target_q|target_moment)_(\d+)"), 0,
     {"actual_q": "q#_rad", "target_q": "q#_cmd_rad", "target_moment": "tau#_Nm"}),
    (re.compile(r"(feedback|planned)_joints_joints_(\d+)"), 0, {"feedback": "q#_deg", "planned": "q#_cmd_deg"}),
    (re.compile(r"(aipos|aspos|geartorque)_a(\d+)"), 1,
     {"aipos": "q#_deg", "aspos": "q#_cmd_deg", "geartorque": "tau#_Nm"}),
    (re.compile(r"(axispos_act|axispos_cmdipo)_?(\d+)"), 1, {"axispos_act": "q#_deg", "axispos_cmdipo": "q#_cmd_deg"}),
    (re.compile(r"(j)(\d+)"), 1, {"j": "q#_deg"}),
)  # fmt: skip


def rename_export(title: str) -> str:
    """Return our name of a column of a logger that is known, any other name as it is."""
    plain = re.sub(r"[\[\]./ _]+", "_", title).strip("_").lower()
    if plain in TIMES:
        return TIMES[plain]
    for pattern, first, names in JOINTS:
        found = pattern.fullmatch(plain)
        if found:
            return names[found[1]].replace("#", str(int(found[2]) + 1 - first))
    return title
