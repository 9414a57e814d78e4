"""Comparison of written programs with the plan, by readback of every program.

The readers are independent of the writers, and the evaluation's robot model (Pinocchio) computes the tool pose. Only
the controller's joint convention is shared with the writers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.readback.fitted import FEED_STEP, PlannedRows, follow_moves
from compplan.controllers.readback.joint_table import read_csv
from compplan.controllers.readback.languages import read_fanuc, read_krl, read_rapid, read_val3
from compplan.controllers.readback.poses import Move, Pose, fanuc_pose
from compplan.controllers.readback.reported import ReportedProgram, read_words
from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript
from compplan.controllers.shapes import LEAST_FEED
from compplan.controllers.writers.joint_convention import (
    JointConvention,
    controller_robot,
    from_controller,
    load_controller,
    load_motion,
    to_controller,
)
from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.robot import Array, Robot, load_robot
from compplan.robot.pose import build_pose

#: File names of each language, for joint programs and programs with positions, and its reader; {} is the name.
FORMS: dict[str, tuple[tuple[str, ...], Callable[[Path], list[Move]] | None]] = {
    "krl": (("{}_J.src", "{}_L.src"), read_krl),
    "val3": (("{}", "{}_L"), read_val3),
    "fanuc_ls": (("{}.LS", "{}_L.LS"), read_fanuc),
    "rapid": (("{}.mod", "{}_L.mod"), read_rapid),
    "urscript": (("{}.script", "{}_L.script"), read_urscript),
    "sinumerik": (("{}.MPF",), read_sinumerik),
    "inform": (("{}.JBI", "{}_L.JBI"), read_inform),
    "kawasaki_as": (("{}.as", "{}_l.as"), read_kawasaki),
    "csv": (("{}_joints.csv",), None),
}
#: Accepted rounding: of a joint [deg or mm], of the tip [mm], of its rotation [deg], of a rotation matrix.
JOINT, PLACE, TURN, MATRIX = 2e-3, 5e-3, 2e-2, 1e-4
#: A line that announces a frame on the next lines, and a decimal number there.
NAMED = re.compile(r"\b(UFRAME|UTOOL|USER FRAME|TOOL)\W*\d+\W+has to be")
DECIMAL = re.compile(r"(?<![\w.])-?\d+\.\d+")


@dataclass(frozen=True)
class StiffArm:
    """The unloaded arm with the job's tool, by the controller's kinematic model, and the part in front of it."""

    carries_part: bool  #: Whether a positioner carries the part; poses are then in the part frame.
    #: Returns position (n, 3) [m] and rotation (n, 3, 3) of the tool at q (n, nq) [rad or m].
    locate: Callable[[Array], tuple[Array, Array]]
    tool: Array  #: Pose of the tool in the pendant's flange frame. Shape (4, 4). [mm]
    part: Array  #: Pose of the part frame in the base frame. Shape (4, 4). [mm]
    mass: float | None  #: Mass of the tool, None where it is not stated. [kg]
    centre: Array  #: Centre of the tool's mass in the TCP frame. Shape (3,). [mm]


def compare_written(
    folder: Path, languages: Sequence[str], robot: Path, arm: StiffArm, planned: PlannedRows,
    find_ends: Callable[[str], tuple[NDArray[np.int_], NDArray[np.bool_]]], *, main: str | None = None,
    may_be_unreadable: bool = False,
) -> tuple[list[str], list[str]]:  # fmt: skip
    """Read back the written programs; return their differences from the plan, and notes on unchecked ones.

    Args:
        folder: Folder of the programs.
        languages: Their languages.
        robot: The robot folder.
        arm: The arm by the evaluation's robot model.
        planned: Planned motion.
        find_ends: Returns the rows at the ends of a language's tool moves (omitted rows are checked against them), and
            whether an exact stop is accepted there: at corners of a language without smaller zones.
        main: The job's name of the main program.
        may_be_unreadable: Whether an unreadable program is not an error, because it uses signals of the cell.
    """
    breaches, notes = list[str](), list[str]()
    if not languages:
        return breaches, notes
    model = load_robot(robot)
    cell = _Cell(model, load_controller(model), arm)
    joints = to_controller(cell.counting, planned.q)
    squared, kept = planned.square_corners()
    declared = np.linalg.inv(cell.world) @ arm.part
    for language in languages:
        if language not in FORMS:  # a language of a third-party package
            notes.append(f"not checked: there is no independent reader of {language} programs")
            continue
        for file, found in _read_back(folder, language, cell, main):
            if isinstance(found, InputError):
                messages, prefix = (notes, "not checked: ") if may_be_unreadable else (breaches, "")
                messages.append(prefix + f"{file.name}: {found.message}"[:200])
                continue
            moves = cell.place_joints([move if move.base is not None else move._replace(base=declared)
                                       for move in found if move.kind != "act"])  # fmt: skip
            linear = planned.fit > 0.0 and any(move.kind != "joint" and move.pose is not None for move in moves)
            every = np.arange(len(joints))
            rows, numbers, (ends, may_stop) = (
                (squared, kept, find_ends(language)) if linear else (planned, every, (every, every < 0))
            )
            held = np.searchsorted(numbers, ends)
            if arm.carries_part and not all(move.carried or move.kind == "joint" for move in moves):
                messages = ["lines are not driven seen from the part that moves"]
            elif len(moves) != len(ends) or not np.isin(ends, numbers).all():
                messages = [f"{len(moves)} moves, planned are {len(ends)}"]
            elif len(missed := np.setdiff1d(np.flatnonzero(rows.kept), held)):
                messages = [f"no move ends at row {missed[0]}, {len(numbers)} are planned"]
            else:
                excused_stops = may_stop & ~rows.exact_stops[held]
                moves = [move._replace(stops=False) if may else move
                         for move, may in zip(moves, excused_stops.tolist(), strict=True)]  # fmt: skip
                messages = [cell.compare_joints(moves, joints[ends]), *cell.compare(rows, moves, held)]
                expected = _report_rows(cell, planned, joints, ends)
                messages = [text for text in messages if text] or expected.compare(language, moves)
            if language in ("fanuc_ls", "inform") and not arm.carries_part:
                messages += compare_declared(file, declared, arm.tool)
            breaches += [f"{file.name}, read back: {text}" for text in messages]
    return breaches, notes


def _read_back(
    folder: Path, language: str, cell: _Cell, main: str | None
) -> Iterator[tuple[Path, list[Move] | InputError]]:
    """Return the programs of a language with their moves, or with the error of their reader."""
    patterns, read = FORMS[language]
    files = _find_mains(folder, patterns, main)
    for file in files:
        try:
            with guard_parser(file, "cannot be read back"):
                moves = read_csv(file, cell.counting.joint_names, cell.outer.tolist()) if read is None else read(file)
        except InputError as error:
            yield file, error
        else:
            yield file, moves
    if not files:
        yield folder / language, InputError("cannot be read back: no program was written")


def _find_mains(folder: Path, patterns: tuple[str, ...], main: str | None) -> list[Path]:
    """Return the main programs of a folder; parts end in a number and are called by them or run one after another."""
    if patterns[0] == "{}":
        return sorted(file.parent for file in folder.glob("*/*.dtx"))
    own = [file for file in folder.glob(f"*{Path(patterns[0]).suffix}") if file.stem.lower() == str(main).lower()]
    if own:
        return own
    endings = tuple(pattern.replace("{}", "") for pattern in patterns)
    files = sorted(file for file in folder.iterdir() if file.name.endswith(endings))
    wholes = {file.stem for file in files}
    mains = []
    for file in files:
        whole = re.sub(r"_\d+$", "", file.stem)
        if whole == file.stem or not {whole, f"{whole}_1"} & wholes:
            mains.append(file)
        elif whole not in wholes and file.stem == f"{whole}_1":  # parts without a main program
            mains.append(file.with_name(whole + file.suffix))
    return mains


@dataclass(frozen=True)
class _Cell:
    """The robot of the programs, by the controller's kinematic model and joint convention; mm and deg."""

    robot: Robot
    counting: JointConvention
    arm: StiffArm

    @property
    def world(self) -> Array:
        """Reference frame of the controller's frames, base frame (in front of a part on a positioner: none)."""
        world = self.counting.world
        return np.eye(4) if self.arm.carries_part else build_pose(1e3 * world[:3, 3], world[:3, :3])

    @property
    def outer(self) -> NDArray[np.bool_]:
        """External axes: joints that slide, or carry the part. Shape (nq,)."""
        return self.robot.prismatic | self.robot.carriers

    def list_joints(self, moves: Sequence[Move]) -> Array:
        """Return the joints of moves in the order of the robot's, nan where their number is wrong. [deg or mm]"""
        outer = self.outer
        shown = np.full((len(moves), len(outer)), np.nan)
        for row, move in zip(shown, moves, strict=True):
            if len(move.joints or ()) == (~outer).sum() and len(move.external) >= outer.sum():
                row[~outer], row[outer] = move.joints, move.external[: outer.sum()]
        return shown

    def place_joints(self, moves: list[Move]) -> list[Move]:
        """Add the tool pose of lines that are written as joint positions, in the part frame."""
        rows = [k for k, move in enumerate(moves) if move.kind != "joint" and move.pose is None and move.joints]
        if not rows or not self.arm.carries_part:
            return moves
        q, placed = from_controller(self.counting, self.list_joints([moves[k] for k in rows])), list(moves)
        for k, position, rotation in zip(rows, *self.arm.locate(q), strict=True):
            placed[k] = moves[k]._replace(
                pose=np.linalg.inv(self.arm.part) @ build_pose(1e3 * position, rotation), base=self.arm.part
            )
        return placed

    def compare(self, rows: PlannedRows, moves: list[Move], held: NDArray[np.int_]) -> list[str]:
        """Return the differences from planned rows, for moves that end at some of them; "" where there is none."""
        lines = [move for move in moves if move.kind != "joint"]
        messages = [self._compare_places(rows, moves, held), self._compare_tool(moves[0])]
        every = _compare_feeds(rows, moves) if len(moves) == len(rows.time) else "rows are left out"
        if every and rows.fit > 0.0 and lines and all(move.pose is not None for move in lines):
            bases = [self.world @ np.asarray(move.base) for move in moves]
            return messages + follow_moves(rows, load_motion(self.robot)[0].cycle, held, moves, bases)
        return [*messages, every]

    def compare_joints(self, moves: list[Move], joints: Array) -> str:
        """Return the difference of the moves' joints from the planned ones, or ""."""
        rows = [k for k, move in enumerate(moves) if move.joints is not None]
        off = np.abs(self.list_joints([moves[k] for k in rows]) - joints[rows])
        if np.isnan(off).any():
            return f"not {self.robot.nq} joints in every move"
        if off.max(initial=0.0) <= JOINT:
            return ""
        row, joint = np.unravel_index(int(off.argmax()), off.shape)
        unit = "mm" if self.robot.prismatic[joint] else "deg"
        return f"{self.robot.joint_names[joint]} is {off.max():.4g} {unit} off at row {rows[row]}"

    def _compare_places(self, planned: PlannedRows, moves: list[Move], held: NDArray[np.int_]) -> str:
        rows = [k for k, move in enumerate(moves) if move.pose is not None and move.base is not None]
        if not rows:
            return ""
        bases = self.world @ np.array([moves[k].base for k in rows])
        if np.abs(bases - self.arm.part).max() > PLACE:
            return "positions do not count from the part frame of the job"
        tip = bases @ np.array([moves[k].pose for k in rows])
        off = np.linalg.norm(tip[:, :3, 3] - planned.position[held[rows]], axis=1)
        if off.max() > PLACE:
            return f"the tip is {off.max():.4g} mm off at row {rows[int(off.argmax())]}"
        if moves[rows[0]].flange_turn:
            return ""
        cosine = np.einsum("nij,nij->n", tip[:, :3, :3], planned.rotation[held[rows]])
        turned = np.degrees(np.arccos(np.clip(0.5 * (cosine - 1.0), -1.0, 1.0)))
        if turned.max() > TURN:
            return f"the tool is turned by {turned.max():.4g} deg at row {rows[int(turned.argmax())]}"
        return ""

    def _compare_tool(self, move: Move) -> str:
        if move.tool is None:
            return ""
        off = float(np.linalg.norm(move.tool[:3, 3] - self.arm.tool[:3, 3]))
        turned = 0.0 if move.flange_turn else float(np.abs(move.tool[:3, :3] - self.arm.tool[:3, :3]).max())
        if off <= PLACE and turned <= MATRIX:
            return ""
        place, planned = (", ".join(f"{value:.4g}" for value in tool[:3, 3]) for tool in (move.tool, self.arm.tool))
        return f"the tool is at ({place}) mm from the pendant's flange, the job's at ({planned})"


def _compare_feeds(rows: PlannedRows, moves: list[Move]) -> str:
    planned = np.maximum(rows.feed, 0.0)
    stated = np.array([np.nan if move.feed is None else move.feed for move in moves])
    off = np.minimum(np.abs(stated - planned), np.abs(stated - np.maximum(planned, LEAST_FEED))) - FEED_STEP
    off[(planned == 0.0) | np.isnan(stated)] = -1.0
    if off.max(initial=-1.0) <= 0.0:
        return ""
    row = int(off.argmax())
    return f"a feed of {stated[row]:.4g} mm/s at row {row}, planned are {planned[row]:.4g}"


def _report_rows(cell: _Cell, planned: PlannedRows, joints: Array, ends: NDArray[np.int_]) -> ReportedProgram:
    """Return the expected contents of a program in addition to the path, at the rows where its moves end."""
    robot, arm = cell.robot, cell.arm
    rates = np.where(robot.prismatic, 1e3, 180.0 / np.pi) * robot.velocity_limits
    step = np.diff(planned.time, prepend=np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (np.abs(np.diff(joints, axis=0, prepend=np.nan)) / rates).max(axis=1) / step
    return ReportedProgram(
        joints[ends][:, ~cell.outer], read_words(cell.counting, controller_robot(robot), planned.q[ends]),
        planned.feed[ends] <= 0.0, planned.exact_stops[ends], share[ends], arm.mass,
        arm.tool[:3, :3] @ (1e3 * arm.centre) + arm.tool[:3, 3],
    )  # fmt: skip


def compare_declared(path: Path, part: Pose, tool: Pose) -> list[str]:
    """Return messages on cell frames in a FANUC or INFORM program that differ from the planned ones.

    The part frame is in the robot's world frame, the tool in the pendant's flange frame. Shape (4, 4). [mm]
    """
    found = []
    for name, declared in read_declared(path).items():
        off = declared - (tool if name == "tool" else part)
        if np.linalg.norm(off[:3, 3]) > PLACE or np.abs(off[:3, :3]).max() > MATRIX:
            found.append(f"the {name} that it expects of the cell is not the planned one")
    return found


def read_declared(path: Path) -> dict[str, Pose]:
    """Read "part frame" and "tool" that a program states for the cell, X Y Z W P R. [mm]"""
    found = {}
    lines = [re.sub(r"^ *\d+: *", "", line) for line in path.read_text().splitlines()]
    for k, line in enumerate(lines):
        if match := NAMED.search(line):
            numbers = [float(number) for later in lines[k + 1 : k + 4] for number in DECIMAL.findall(later)]
            found["part frame" if "FRAME" in match[1] else "tool"] = fanuc_pose(*numbers[:6])
    return found
