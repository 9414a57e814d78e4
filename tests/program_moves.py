"""What readers of programs have in common; see `compplan.second.programs`."""

from compplan.second.programs.poses import (
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
    "NUMBER", "Move", "Pose", "abb_pose", "fanuc_pose", "kawasaki_pose", "kuka_pose", "read_numbers", "shift",
    "turn", "vector_pose",
]
