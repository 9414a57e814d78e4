"""Robot models: URDF chain, elasticity, and robot folders."""

from compplan.robot.folder import (
    as_read,
    find_robot_folder,
    load_robot,
    read_robot_folder,
    robot_folders,
    write_robot_folder,
)
from compplan.robot.model import (
    GRADES,
    SPRING_AXES,
    Array,
    Body,
    Joint,
    LinkElasticity,
    Mimic,
    Robot,
    Spring,
    roll_pitch_yaw_of,
)
