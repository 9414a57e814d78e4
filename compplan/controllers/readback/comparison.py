"""Compare what was written with what was planned: joints.csv and every program are read back.

Joints are counted back by a reading of controller.toml of its own, and the tool is placed by the evaluation's robot
model (Pinocchio); nothing goes through the writers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from compplan.controllers.readback.controller import ReadCounting, read_counting
from compplan.controllers.readback.declared import compare_declared
from compplan.controllers.readback.fanuc_abb import read_csv, read_fanuc, read_rapid
from compplan.controllers.readback.fitted import CRAWL, PlannedRows, check_corners, find_rows, follow_moves
from compplan.controllers.readback.frames import read_frame, read_part
from compplan.controllers.readback.joint_table import Commanded, check_joint_table, check_posture_choice, to_degrees
from compplan.controllers.readback.kuka_staubli import read_krl, read_val3
from compplan.controllers.readback.poses import Move
from compplan.controllers.readback.posture import read_words
from compplan.controllers.readback.reported import ReportedProgram
from compplan.controllers.readback.robot import JointTable, read_joints
from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript
from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.io.tomlfile import read_toml
from compplan.robot import Array

#: Files that each language writes, joint programs and programs with positions, and who reads them; {} is the name.
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
#: Rounding that programs leave: of a joint [deg or mm], of the tip [mm], of its turn [deg], of a feed (share).
JOINT, PLACE, TURN, FEED = 2e-3, 5e-3, 2e-3, 2e-2
#: Rounding of feeds that are written with one decimal. [mm/s]
FEED_STEP = 0.06
#: Cycle of a controller (assumed). [s]
CYCLE = 0.004


@dataclass(frozen=True)
class Findings:
    """What a reading of written files finds: sentences against a plan, and what was not checked."""

    breaches: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class StiffArm:
    """Forward kinematics of the unloaded arm as the controller believes it.

    Attributes:
        carries_part: Whether a positioner carries the part; poses are then seen from the part.
        locate: Returns position (n, 3) [m] and rotation (n, 3, 3) of the tool at q (n, nq). [rad or m]

    """

    carries_part: bool
    locate: Callable[[Array], tuple[Array, Array]]


def compare_written(
    folder: Path, tables: Mapping[str, Any], robot: Path, wanted: Commanded,
    arm_with: Callable[[Mapping[str, Any] | None], StiffArm],
) -> Findings:  # fmt: skip
    """Read back what was written.

    Args:
        folder: Folder that joints.csv and the programs are in.
        tables: The tables of the job as they are written.
        robot: The robot folder.
        wanted: What was planned.
        arm_with: Returns the arm with a table [tool], or with the folder's own tool where it is None.

    """
    joints = read_joints(robot)
    breaches = [
        *check_posture_choice(wanted, _read_cycle(robot)),
        *check_joint_table(folder / "joints.csv", joints, wanted),
    ]
    notes: list[str] = []
    output = tables.get("output") or {}
    if not output.get("programs"):
        return Findings(tuple(breaches))
    counting = read_counting(robot, joints.outer)
    arm = arm_with(tables.get("tool"))
    rows = wanted.program
    position, rotation = arm.locate(wanted.sent[rows])
    stand = _Stand(
        joints, counting, to_degrees(wanted.sent[rows], joints), position * 1e3, rotation,
        np.eye(4) if arm.carries_part else _world(robot), wanted,
        _part(tables), _tool(arm_with({"frame": "pendant"}), wanted.sent[rows[:1]], position[0], rotation[0]),
        wanted.fit, _read_cycle(robot), arm,
    )  # fmt: skip
    reported = _say(stand, tables, robot)
    squared, kept = stand.square_corners()
    own = {name for key in ("header", "footer") for name in (output.get(key) or {})}
    for language in output["programs"]:
        if language not in FORMS:  # a language of somebody else's package
            notes.append(f"not checked: there is no independent reader of {language} programs")
            continue
        excused = language in own or bool(output.get("io"))
        for file, found in _read_back(folder, language, counting, output.get("main")):
            if isinstance(found, InputError):
                fault = f"{file.name}: {found.message}"[:200]
                (notes if excused else breaches).append(f"not checked: {fault}" if excused else fault)
            else:
                moves = stand.place_joints([stand.take_frame(move) for move in found if move.kind != "act"])
                linear = stand.fitted and any(move.kind != "joint" and move.pose is not None for move in moves)
                own_stand, own_rows = (squared, kept) if linear else (stand, np.arange(len(stand.q)))
                held = own_stand.find_rows(moves)
                moves = moves if isinstance(held, str) else own_stand.excuse_stops(moves, held)
                if stand.arm.carries_part and not all(move.carried or move.kind == "joint" for move in moves):
                    said = ["lines are not driven seen from the part that moves"]
                elif isinstance(held, str):
                    said = [held]
                else:
                    said = own_stand.compare(moves, held) or reported.take(own_rows[held]).compare(language, moves)
                    said += stand.check_corners() if linear else []
                if language in ("fanuc_ls", "inform") and not stand.arm.carries_part:
                    said += compare_declared(file, np.linalg.inv(stand.world) @ stand.part, stand.tool)
                breaches += [f"{file.name}, read back: {text}" for text in said]
    return Findings(tuple(breaches), tuple(notes))


def _read_back(
    folder: Path, language: str, counting: ReadCounting, main: str | None
) -> Iterator[tuple[Path, list[Move] | InputError]]:
    """Return the programs of a language and their moves, or what kept them from being read."""
    patterns, read = FORMS[language]
    files = _find_mains(folder, patterns, main)
    for file in files:
        try:
            with guard_parser(file, "cannot be read back"):
                moves = read_csv(file, counting.names, counting.external) if read is None else read(file)
        except InputError as error:
            yield file, error
        else:
            yield file, moves
    if not files:
        yield folder / language, InputError("cannot be read back: no program was written")


def _find_mains(folder: Path, patterns: tuple[str, ...], main: str | None) -> list[Path]:
    """Return the programs of a folder; parts, that end in a number, are called by them or run after each other."""
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
        elif whole not in wholes and file.stem == f"{whole}_1":  # parts without a whole
            mains.append(file.with_name(whole + file.suffix))
    return mains


@dataclass(frozen=True)
class _Stand:
    """The commanded arm at the rows that programs hold, in the geometry that the controller believes; mm and deg."""

    joints: JointTable
    counting: ReadCounting
    q: Array
    position: Array
    rotation: Array
    world: Array
    wanted: Commanded
    part: Array
    tool: Array
    tolerance: float
    cycle: float
    arm: StiffArm

    @property
    def fitted(self) -> bool:
        """Tell whether moves of the tool stand for rows between them."""
        return self.tolerance > 0.0

    def square_corners(self) -> tuple[_Stand, NDArray[np.int_]]:
        """Return what moves of the tool stand for, corners in place of what rounds them, and the rows of it."""
        kept = np.flatnonzero(np.isfinite(self.wanted.corner[:, 0]))
        wanted = self.wanted.take(kept)
        position = self.position[kept] + 1e3 * wanted.corner
        return replace(self, q=self.q[kept], position=position, rotation=self.rotation[kept], wanted=wanted), kept

    def check_corners(self) -> list[str]:
        """Say where the rows of a rounded corner lie too far beside the corner that programs state."""
        wanted = self.wanted
        return check_corners(self.position, 1e3 * wanted.corner, 1e3 * wanted.beside, self.tolerance)[:1]

    def take_frame(self, move: Move) -> Move:
        """Return a move whose positions count from a frame of the cell as if that were the part frame."""
        return move if move.base is not None else move._replace(base=np.linalg.inv(self.world) @ self.part)

    def place_joints(self, moves: list[Move]) -> list[Move]:
        """Put the tool of lines that are written as joint positions where those hold it, seen from the part frame."""
        rows = [k for k, move in enumerate(moves) if move.kind != "joint" and move.pose is None and move.joints]
        if not rows or not self.arm.carries_part:
            return moves
        shown = np.empty((len(rows), len(self.counting.zero)))
        shown[:, ~self.counting.external] = [moves[k].joints for k in rows]
        shown[:, self.counting.external] = [moves[k].external for k in rows]
        degrees = self.counting.undo(shown)
        q = np.where(np.array(self.joints.slides), 1e-3 * degrees, np.radians(degrees))
        placed = list(moves)
        for k, position, rotation in zip(rows, *self.arm.locate(q), strict=True):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, 1e3 * position
            placed[k] = moves[k]._replace(pose=np.linalg.inv(self.part) @ pose, base=self.part)
        return placed

    def find_rows(self, moves: list[Move]) -> NDArray[np.int_] | str:
        """Return the row at which each move ends, or what speaks against it."""
        if len(moves) == len(self.q):
            return np.arange(len(moves))
        if not self.fitted or not any(move.kind != "joint" for move in moves):
            return f"{len(moves)} moves, planned are {len(self.q)}"
        ends = np.full((len(moves), 4, 4), np.nan)
        held: list[NDArray[np.bool_] | None] = []
        for k, move in enumerate(moves):
            if move.pose is not None and move.kind != "joint":
                ends[k] = self.world @ np.asarray(move.base) @ move.pose
            if move.flange_turn:
                ends[k, :3, :3] = np.nan
            held.append(self._match_joints(move) if move.kind == "joint" and move.joints is not None else None)
        return find_rows(self._lay_rows(), ends[:, :3, 3], ends[:, :3, :3], held)

    def _match_joints(self, move: Move) -> NDArray[np.bool_]:
        """Tell the rows whose joints are those of a move. Shape (m,)."""
        outer, counting = int(self.counting.external.sum()), self.counting
        shown = np.full((1, len(counting.zero)), np.nan)
        if len(move.joints or ()) != shown.shape[1] - outer or len(move.external) < outer:
            return np.zeros(len(self.q), bool)
        shown[:, ~counting.external] = move.joints
        shown[:, counting.external] = move.external[:outer]
        return np.asarray((np.abs(counting.undo(shown) - self.q) <= JOINT).all(axis=1))

    def excuse_stops(self, moves: list[Move], held: NDArray[np.int_]) -> list[Move]:
        """Take exact stops at corners whose zone would lead too far, in a language without smaller ones, as zones."""
        excused = (self.wanted.may_stop & ~self.wanted.stands)[held].tolist()
        return [move._replace(stops=False) if may else move for move, may in zip(moves, excused, strict=True)]

    def _lay_rows(self) -> PlannedRows:
        wanted = self.wanted
        rows = wanted.program
        kept = (wanted.feed[rows] <= 0.0) | wanted.stands
        kept[:-1] |= wanted.feed[rows][1:] <= 0.0
        kept[-1] = True
        return PlannedRows(
            self.position, self.rotation, wanted.time[rows], kept, wanted.free, self.tolerance * wanted.coarser[rows],
            self.cycle, wanted.asked, np.abs(wanted.corner).max(axis=1) > 0.0,
        )  # fmt: skip

    def compare(self, moves: list[Move], held: NDArray[np.int_]) -> list[str]:
        """Say where the moves of a program, which end at some of the rows, are not those planned."""
        linear = any(move.kind != "joint" for move in moves)
        stand = replace(self, q=self.q[held], position=self.position[held], rotation=self.rotation[held])
        said = [stand._compare_joints(moves), stand._compare_places(moves), self._compare_tool(moves)]
        if self.fitted and linear and all(move.pose is not None for move in moves if move.kind != "joint"):
            bases = [self.world @ np.asarray(move.base) for move in moves]
            said += follow_moves(self._lay_rows(), held, moves, bases)
        else:
            said.append(self._compare_feeds(moves))
        return [text for text in said if text]

    def _compare_joints(self, moves: list[Move]) -> str:
        rows = np.array([k for k, move in enumerate(moves) if move.joints is not None], int)
        if not len(rows):
            return ""
        outer = int(self.counting.external.sum())
        shown = np.empty((len(rows), len(self.counting.zero)))
        arm = np.array([moves[k].joints for k in rows], float)
        if arm.shape[1] != shown.shape[1] - outer:
            return f"{arm.shape[1]} joints, the arm has {shown.shape[1] - outer}"
        shown[:, ~self.counting.external] = arm
        if outer:
            shown[:, self.counting.external] = np.array([moves[k].external[:outer] for k in rows], float)
        off = np.abs(self.counting.undo(shown) - self.q[rows])
        if off.max() <= JOINT:
            return ""
        row, joint = np.unravel_index(int(off.argmax()), off.shape)
        unit = "mm" if self.joints.slides[joint] else "deg"
        return f"{self.joints.names[joint]} is {off.max():.4g} {unit} off at row {rows[row]}"

    def _compare_places(self, moves: list[Move]) -> str:
        rows = [k for k, move in enumerate(moves) if move.pose is not None and move.base is not None]
        if not rows:
            return ""
        pose = np.array([moves[k].pose for k in rows])
        bases = {id(moves[k].base): moves[k].base for k in rows}
        seen: dict[int, Array] = {key: self.world @ np.asarray(base) for key, base in bases.items()}
        carried = np.array([seen[id(moves[k].base)] for k in rows])
        if np.abs(carried - self.part).max() > PLACE:
            return "positions do not count from the part frame of the job"
        tip = carried @ pose
        off = np.linalg.norm(tip[:, :3, 3] - self.position[rows], axis=1)
        if off.max() > PLACE:
            return f"the tip is {off.max():.4g} mm off at row {rows[int(off.argmax())]}"
        if moves[rows[0]].flange_turn:
            return ""
        cosine = np.einsum("nij,nij->n", tip[:, :3, :3], self.rotation[rows])
        turned = np.degrees(np.arccos(np.clip(0.5 * (cosine - 1.0), -1.0, 1.0)))
        if turned.max() > 10 * TURN:
            return f"the tool is turned by {turned.max():.4g} deg at row {rows[int(turned.argmax())]}"
        return ""

    def _compare_tool(self, moves: list[Move]) -> str:
        tool = moves[0].tool
        if tool is None:
            return ""
        off = float(np.linalg.norm(tool[:3, 3] - self.tool[:3, 3]))
        turned = 0.0 if moves[0].flange_turn else float(np.abs(tool[:3, :3] - self.tool[:3, :3]).max())
        if off <= PLACE and turned <= 1e-4:
            return ""
        place = ", ".join(f"{value:.4g}" for value in tool[:3, 3])
        wanted = ", ".join(f"{value:.4g}" for value in self.tool[:3, 3])
        return f"the tool is at ({place}) mm from the pendant's flange, the job's at ({wanted})"

    def _compare_feeds(self, moves: list[Move]) -> str:
        wanted = self.wanted.feed[self.wanted.program] * 1e3
        stated = np.array([np.nan if move.feed is None or move.kind != "line" else move.feed for move in moves])
        sure = np.isfinite(stated) & (wanted > 0.0)
        off = np.abs(np.where(sure, stated / np.where(sure, wanted, 1.0), 1.0) - 1.0)
        off[np.abs(np.where(sure, stated - wanted, 0.0)) <= FEED_STEP] = 0.0
        off[np.maximum(np.nan_to_num(stated), wanted) <= CRAWL] = 0.0
        if off.max(initial=0.0) <= FEED:
            return ""
        row = int(off.argmax())
        return f"a feed of {stated[row]:.4g} mm/s at row {row}, planned are {wanted[row]:.4g}"


def _say(stand: _Stand, tables: Mapping[str, Any], robot: Path) -> ReportedProgram:
    """Return what programs have to say beside where they lead."""
    wanted, counting, joints = stand.wanted, stand.counting, stand.joints
    rows = wanted.program
    shown = counting.show(stand.q)
    step = np.diff(wanted.time[rows], prepend=np.nan)
    rates = to_degrees(joints.velocity[None], joints)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (np.abs(np.diff(shown, axis=0, prepend=np.nan)) / rates).max(axis=1) / step
    tool = tables.get("tool") or {}
    mass, centre = tool.get("mass_kg"), np.array(tool.get("centre_of_mass_mm", (0.0, 0.0, 0.0)), float)
    seen = stand.tool @ np.linalg.inv(_millimetres(read_frame(tool))) @ np.r_[centre, 1.0]
    words = read_words(robot, joints.names, wanted.sent[rows])
    return ReportedProgram(
        shown[:, ~counting.external], words, wanted.feed[rows] <= 0.0, wanted.stands, share, mass, seen[:3]
    )


def _read_cycle(robot: Path) -> float:
    """Return the cycle of a robot's controller, as its folder states it. [s]"""
    file = robot / "controller.toml"
    table = read_toml(file).get("motion", {}) if file.is_file() else {}
    return 1e-3 * float(table.get("cycle_ms", 1e3 * CYCLE))


def _millimetres(frame: pin.SE3) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = frame.rotation, 1e3 * frame.translation
    return pose


def _part(tables: Mapping[str, Any]) -> Array:
    """Return the part frame of a job, seen from the base. Shape (4, 4). [mm]"""
    return _millimetres(read_part(tables.get("part") or {}))


def _tool(arm: StiffArm, q: Array, position: Array, rotation: Array) -> Array:
    """Return the tool of a posture, seen from the flange frame of the teach pendant. Shape (4, 4). [mm]"""
    at, turn = arm.locate(q)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn[0].T @ rotation, 1e3 * turn[0].T @ (position - at[0])
    return pose


def _world(robot: Path) -> Array:
    """Return the frame that the controller's frames count from, seen from the base. Shape (4, 4). [mm]"""
    file, pose = robot / "controller.toml", np.eye(4)
    table = read_toml(file).get("world", {}) if file.is_file() else {}
    pose[:3, :3] = pin.exp3(np.radians(table.get("rotation_deg", (0.0, 0.0, 0.0))))
    pose[:3, 3] = table.get("position_mm", (0.0, 0.0, 0.0))
    return pose
