"""What readers of programs have in common; see `compplan.controllers.readback`."""

from compplan.controllers.readback.poses import (
    NUMBER,
    Move,
    Pose,
    abb_pose,
    fanuc_pose,
    kawasaki_pose,
    kuka_pose,
    read_numbers,
    shift,
    turn,
    vector_pose,
)

__all__ = [
    "NUMBER",
    "Move",
    "Pose",
    "abb_pose",
    "fanuc_pose",
    "kawasaki_pose",
    "kuka_pose",
    "read_numbers",
    "shift",
    "turn",
    "vector_pose",
]
