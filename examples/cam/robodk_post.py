"""A RoboDK post processor that corrects the program with compplan.

Copy the file into RoboDK's folder Posts, install compplan in the Python that RoboDK runs posts with, set the four names
below, and choose the post for the robot. RoboDK calls the methods of `RobotPost` in the order of the program; moves,
tool, frame and feeds go to `compplan.post`, which writes corrected programs beside the saved one.

Joint moves become rapid moves, circles are refused: turn on splitting of arcs in RoboDK. Signals are not carried over.
Tried on a recorded sequence of calls alone (tests/controllers/test_cam_posts.py), not in RoboDK.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import compplan as cp

#: The robot model (a shipped robot or a folder), the languages, the force ([process] of a job; None: no force), and
#: [plan]: strategy, tolerance, posture.
ROBOT: str = "kuka_kr240"
PROGRAMS: tuple[str, ...] = ("krl",)
PROCESS: dict[str, Any] | str | None = None
PLAN: dict[str, Any] | None = None


def read_pose(pose: Any) -> np.ndarray:
    """Return a pose of RoboDK (`robodk.robomath.Mat`, rows of mm) as a 4x4 array."""
    return np.array(pose.Rows() if hasattr(pose, "Rows") else pose, float)


def describe_frame(pose: np.ndarray) -> dict[str, list[float]]:
    """Return a frame as a table of a job: position in mm, rotation vector in deg."""
    turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True)
    return {"position_mm": pose[:3, 3].round(6).tolist(), "rotation_deg": turn.round(9).tolist()}


class RobotPost:
    """Gather a program of RoboDK and hand it to compplan.

    Attributes:
        LOG: What was noted, one line each.
        posted: What `compplan.post` returned, once the program is saved.
    """

    PROG_EXT = "csv"

    def __init__(self, robotpost: str = "", robotname: str = "", robot_axes: int = 6, **kwargs: Any) -> None:
        self.name, self.LOG, self.posted = "program", "", None
        self.feed, self.rows = 50.0, list[list[float]]()
        self.frame, self.tool = np.eye(4), np.eye(4)

    def ProgStart(self, progname: str) -> None:
        """Begin a program."""
        self.name, self.rows = progname, []

    def ProgFinish(self, progname: str) -> None:
        """End a program; it is handed over when it is saved."""

    def ProgSave(self, folder: str, progname: str, ask_user: bool = False, show_result: bool = False) -> None:
        """Write the path and correct it; programs, plan.json and report.html go into FOLDER/NAME_corrected."""
        path = Path(folder) / f"{progname}.csv"
        head = "x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid"
        np.savetxt(
            path, self.rows, fmt=[*["%.6f"] * 3, *["%.9f"] * 3, "%.4f", "%d"], delimiter=",", header=head, comments=""
        )
        self.posted = cp.post(
            path, robot=ROBOT, part=describe_frame(self.frame), program=PROGRAMS, process=PROCESS, plan=PLAN,
            tool={"frame": "pendant", **describe_frame(self.tool)}, out=Path(folder) / f"{progname}_corrected",
        )  # fmt: skip
        self.LOG = "\n".join([self.LOG, f"{self.posted.status}: {self.posted.folder}", *self.posted.notes]).strip()

    def ProgSendRobot(self, robot_ip: str, remote_path: str, ftp_user: str, ftp_pass: str) -> None:
        """Send nothing: a corrected program is looked at before it runs."""
        self.LOG += "\nthe program is not sent to the robot"

    def _add(self, pose: Any, *, rapid: bool) -> None:
        if pose is None:
            raise ValueError("a joint target without a pose cannot be corrected: make it a Cartesian target")
        target = read_pose(pose)
        self.rows.append([*target[:3, 3], *(-target[:3, 2]), self.feed, int(rapid)])

    def MoveJ(self, pose: Any, joints: Any, conf_RLF: Any = None) -> None:
        """Add a joint move, as a rapid move to its target."""
        self._add(pose, rapid=True)

    def MoveL(self, pose: Any, joints: Any, conf_RLF: Any = None) -> None:
        """Add a linear move at the feed that was set."""
        self._add(pose, rapid=False)

    def MoveC(self, pose1: Any, joints1: Any, pose2: Any, joints2: Any, *configurations: Any) -> None:
        """Refuse a circle."""
        raise ValueError("circles are not taken: turn on splitting of arcs in RoboDK")

    def setFrame(self, pose: Any, frame_id: int | None = None, frame_name: str | None = None) -> None:
        """Set the frame of the targets, seen from the robot base; a program has one."""
        if self.rows and not np.allclose(read_pose(pose), self.frame):
            raise ValueError("the frame changes within the program: make a program of each frame")
        self.frame = read_pose(pose)

    def setTool(self, pose: Any, tool_id: int | None = None, tool_name: str | None = None) -> None:
        """Set the tool, seen from the flange as the teach pendant shows it; a program has one."""
        if self.rows and not np.allclose(read_pose(pose), self.tool):
            raise ValueError("the tool changes within the program: make a program of each tool")
        self.tool = read_pose(pose)

    def setSpeed(self, speed_mms: float) -> None:
        """Set the feed of linear moves. [mm/s]"""
        self.feed = float(speed_mms)

    def __getattr__(self, name: str) -> Any:
        """Note every other call, such as setZoneData or RunMessage: it changes no move."""
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *values, **more: setattr(self, "LOG", f"{self.LOG}\n{name}{values} is not carried over".strip())
