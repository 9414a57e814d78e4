"""Robot program independent of a language: joint positions in the controller's convention, feeds and poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.frames import compute_tool_mass, flange_turn
from compplan.controllers.writers.joint_convention import (
    controller_robot,
    find_bend,
    krl_status,
    load_controller,
    locate_links,
    measure_words,
    native_words,
    to_controller,
)
from compplan.controllers.writers.machine import Wiring
from compplan.controllers.writers.text import clean_text
from compplan.errors import InputError, ShapeError
from compplan.io.tables import Array
from compplan.robot import Robot
from compplan.toolpath.events import Event, find_halts

#: Joint positions below this are written as zero, without a sign. [deg or mm]
ZERO = 5e-7
#: Shape of one row of each attribute of a program with rows, except joints and configuration words.
BY_ROW: dict[str, tuple[int, ...]] = {
    "feed": (), "rapid": (), "exact": (), "time": (), "tcp": (4, 4), "status": (), "bent": (), "free": (),
    "arc_of": (), "line_of": (), "corner": (), "corner_shift": (3,), "asked": (), "via": (4, 4),
}  # fmt: skip


@dataclass(frozen=True)
class Post:
    """Settings of a job for the text around the moves of a program."""

    template: Path | None = None  #: File of the job's template, or None for the package's template.
    tool: int | str | None = None  #: Number or name of the cell's tool data, None for the tool of the job.
    base: int | str | None = None  #: Number or name of the cell's frame, None for the part frame of the job.
    overwrite: bool = False  #: Whether programs overwrite the cell's tool data and frame with those of the job.
    main: str | None = None  #: Name of the main program, None for that of the job.

    @property
    def words(self) -> dict[str, Any]:
        """The settings that a template gets: all but its file, an object with methods that write files."""
        return {key: value for key, value in vars(self).items() if key != "template"}


@dataclass(frozen=True, eq=False)
class Program:
    """A program; row i describes the move that ends at waypoint i."""

    name: str  #: Name; writers shorten it to what a language allows.
    joints: Array  #: Commanded joint positions in the controller's convention. Shape (n, nq). [deg or mm]
    joint_names: tuple[str, ...]  #: The controller's names of the joints, from the base.
    prismatic: NDArray[np.bool_]  #: Which joints slide. Shape (nq,).
    feed: Array  #: Feed; 0 for rapid moves. Shape (n,). [mm/s]
    rapid: NDArray[np.bool_]  #: Which moves are rapid. Shape (n,).
    #: Commanded TCP poses by the controller's kinematic model, base frame. Shape (n, 4, 4). [m]
    tcp: Array
    #: Pose of the TCP frame in the controller's flange frame (z out of the flange). Shape (4, 4). [m]
    tool: Array = field(default_factory=lambda: np.eye(4))
    #: Exact stops in addition to those that `stops` finds, or None. Shape (n,).
    exact: NDArray[np.bool_] | None = None
    time: Array | None = None  #: Time at each waypoint, or None. Shape (n,). [s]
    rates: Array | None = None  #: Greatest joint rates, or None. Shape (nq,). [deg/s or mm/s]
    #: Pose of the part frame in the base frame; reference of Cartesian positions. Shape (4, 4). [m]
    part: Array = field(default_factory=lambda: np.eye(4))
    #: Pose of the reference frame of the controller's frames, in the base frame. Shape (4, 4). [m]
    world: Array = field(default_factory=lambda: np.eye(4))
    mass: float | None = None  #: Mass of the tool, or None where it is not stated. [kg]
    #: Centre of its mass in the controller's flange frame. Shape (3,). [m]
    centre: Array = field(default_factory=lambda: np.zeros(3))
    status: NDArray[np.int64] | None = None  #: S of KRL positions, or None. Shape (n,).
    #: Sign of the wrist bend: False below the fifth axis' singular angle, or None. Shape (n,).
    bent: NDArray[np.bool_] | None = None
    #: Value of each configuration word at every waypoint: {"wrist": ["flip", ...], ...}. Shape (n,) each.
    words: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)
    #: The same in the controller's words, where controller.toml has them. Shape (n,) each.
    native: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)
    unchecked: str = ""  #: Reason why signs and zeros of the joints are not known; "" where they are.
    robot: str = ""  #: Name of the robot.
    controller: str = ""  #: Name of the controller.
    comments: tuple[str, ...] = ()  #: Lines for the head of every file.
    #: Machine events, each after the row in `place`; -1: before the first move.
    events: tuple[Event, ...] = ()
    wiring: Wiring = field(default_factory=Wiring)  #: Signals of the cell for the events.
    post: Post = field(default_factory=Post)  #: Settings for the text around the moves.
    tolerance: float = 0.0  #: Greatest distance of written lines and arcs from the tip; 0: a move per waypoint. [m]
    cycle: float = 0.0  #: Least time of a written move. [s]
    #: Moves without a prescribed speed, such as those that blend in a correction, or None. Shape (n,).
    free: NDArray[np.bool_] | None = None
    form: str = "both"  #: "linear": only tool moves where a language can write them; "joint", "both".
    #: Via pose of the arc to each waypoint, nan for lines, or None. Shape (n, 4, 4). [m]
    via: Array | None = None
    #: Number of the arc of the CAM file that each move is a chord of, 0 for none; or None. Shape (n,).
    arc_of: NDArray[np.int_] | None = None
    #: CAM file line of each move, 0 where not known; or None. Shape (n,).
    line_of: NDArray[np.int_] | None = None
    #: Which joints carry the part, or None. `tcp` and `part` are then relative to the last of them. Shape (nq,).
    carries: NDArray[np.bool_] | None = None
    #: Greatest distance from the path in the zone of each row, or None for the language's default zone. Shape (n,). [m]
    corner: Array | None = None
    #: Vector from a row to the corner that replaces it in programs; nan at omitted rows of a rounded corner, 0 at other
    #: rows; or None. Base axes. Shape (n, 3). [m]
    corner_shift: Array | None = None
    asked: Array | None = None  #: Feed of the CAM file, or None. Shape (n,). [mm/s]
    blend_share: float = 1.0  #: Ratio of the controller's blend lengths to their zones.
    smoothing: float = 0.04  #: Averaging time of the speed in the controller. [s]

    def __post_init__(self) -> None:
        n, nq = self.joints.shape
        shapes = {name: (n, *row) for name, row in BY_ROW.items()} | {"rates": (nq,), "carries": (nq,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and np.shape(array) != shape:
                raise ShapeError(f"program {name} has shape {np.shape(array)}, expected {shape}")
        if len(self.joint_names) != nq:
            raise ShapeError(f"program has {len(self.joint_names)} joint names, expected {nq}")

    def __len__(self) -> int:
        return len(self.joints)

    def take(self, rows: NDArray[np.int_]) -> Program:
        """Return the program reduced to some rows, which include ends of moves and events."""
        some: dict[str, Any] = {
            name: None if (values := getattr(self, name)) is None else values[rows] for name in ("joints", *BY_ROW)
        }
        words, native = ({key: values[rows] for key, values in table.items()} for table in (self.words, self.native))
        place = np.searchsorted(rows, [event.place for event in self.events]).tolist()
        events = tuple(
            replace(event, place=new if event.place >= 0 else -1) for event, new in zip(self.events, place, strict=True)
        )
        return replace(self, **some, words=words, native=native, events=events)

    @property
    def corners(self) -> NDArray[np.bool_]:
        """Rows at a rounded corner of the path. Shape (n,)."""
        return np.zeros(len(self), bool) if self.corner_shift is None else np.abs(self.corner_shift).max(axis=1) > 0.0

    @property
    def moves_part(self) -> bool:
        """Whether joints carry the part."""
        return self.carries is not None and bool(self.carries.any())

    @property
    def outer(self) -> NDArray[np.bool_]:
        """External axes: joints that slide, or carry the part. Shape (nq,)."""
        return self.prismatic if self.carries is None else self.prismatic | self.carries

    @property
    def base_frame(self) -> Array:
        """Pose of the part frame in the base frame; with a positioner, in that of the link that carries the part.

        Shape (4, 4) [m].
        """
        return np.asarray(np.linalg.inv(self.world) @ self.part)

    @property
    def positions(self) -> Array:
        """Commanded TCP poses in the part frame. Shape (n, 4, 4) [m]."""
        return np.asarray(np.linalg.inv(self.part) @ self.tcp)

    @property
    def arcs(self) -> NDArray[np.bool_]:
        """Moves that are arcs. Shape (n,)."""
        return np.zeros(len(self), bool) if self.via is None else np.isfinite(self.via[:, 0, 0])

    @property
    def via_positions(self) -> Array:
        """Via poses of arcs in the part frame; nan for other moves. Shape (n, 4, 4) [m]."""
        via = np.full((len(self), 4, 4), np.nan) if self.via is None else self.via
        return np.asarray(np.linalg.inv(self.part) @ via)

    def write_comment_line(self, row: int, sign: str) -> str:
        """Return a comment with the CAM file line of a move, after the comment sign of a language."""
        line = 0 if self.line_of is None else int(self.line_of[row])
        return f" {sign} CAM line {line}" if line else ""

    @property
    def swings(self) -> NDArray[np.bool_]:
        """Cutting moves in which a configuration word or the wrist bend changes, so that a straight move is impossible.

        Shape (n,).
        """
        changed = np.zeros(len(self), dtype=bool)
        for values in (*self.words.values(), *([] if self.bent is None else [self.bent])):
            changed[1:] |= values[1:] != values[:-1]
        return changed & ~self.rapid

    def alone(self, *, linear: bool) -> NDArray[np.bool_]:
        """Return which moves are joint moves: rapid moves, and lines that change the arm configuration. Shape (n,)."""
        return self.rapid | self.swings if linear else self.rapid

    def stops(self, *, linear: bool) -> NDArray[np.bool_]:
        """Return which moves end in a stop: joint moves, moves before them, events, and `exact`. Shape (n,)."""
        alone = self.alone(linear=linear)
        stops = alone | np.append(alone[1:], True)
        stops[find_halts(self.events)] = True
        return np.asarray(stops if self.exact is None else stops | self.exact)


def build_program(
    robot: Robot,
    q: Array,
    feed: Array,
    rapid: NDArray[np.bool_],
    *,
    name: str,
    time: Array | None = None,
    comments: Sequence[str] = (),
    part: Array | None = None,
    exact: NDArray[np.bool_] | None = None,
    events: Sequence[Event] = (),
    wiring: Wiring | None = None,
) -> Program:
    """Build a program, in the joint convention and kinematic model of the controller, from commanded joint positions.

    Args:
        robot: The robot; its folder holds the controller's conventions.
        q: Commanded joint positions, in the convention of `robot`. Shape (n, nq). [rad or m]
        feed: Feed of the move that ends at each waypoint. Shape (n,). [m/s]
        rapid: Which moves are rapid. Shape (n,).
        name: Name of the program.
        time: Time at each waypoint, or None. Shape (n,). [s]
        comments: Lines for the head of every file.
        part: Pose of the part frame in the base frame; left out: the base itself. Shape (4, 4). [m]
        exact: Waypoints to stop at exactly, besides the ends of cuts and of rapid moves. Shape (n,).
        events: Machine events; each comes after waypoint `event.place`, -1: before the first move.
        wiring: Signals of the cell for the events; left out: the program stops for the operator at each but coolant.

    Raises:
        InputError: If controller.toml or controller.urdf of the robot's folder is not valid.
    """
    believed, controller = controller_robot(robot), load_controller(robot)
    limits, joints, poses = robot.velocity_limits, to_controller(controller, q), locate_links(believed, q)
    words = {key: values for key, (values, _) in measure_words(controller, believed, q, poses).items()}
    tip, turned = poses[robot.tcp], flange_turn(robot)
    mass, centre = compute_tool_mass(robot)
    return Program(
        name=name,
        joints=np.where(np.abs(joints) < ZERO, 0.0, joints),
        joint_names=controller.joint_names,
        rates=np.where(robot.prismatic, 1e3 * limits, np.degrees(limits)) if np.isfinite(limits).all() else None,
        world=np.eye(4) if robot.ground else controller.world,
        words=words,
        native=native_words(controller, words),
        status=krl_status(controller, words),
        bent=find_bend(believed, poses),
        unchecked=controller.unchecked,
        controller=controller.name,
        prismatic=robot.prismatic,
        feed=np.where(rapid, 0.0, np.asarray(feed) * 1e3),
        rapid=np.asarray(rapid, dtype=bool),
        exact=exact,
        time=time,
        tcp=tip,
        tool=np.linalg.inv(poses[robot.flange][0] @ turned) @ tip[0],
        part=np.eye(4) if part is None else np.asarray(part, dtype=np.float64),
        carries=robot.carriers,
        mass=mass,
        centre=turned[:3, :3].T @ (centre - turned[:3, 3]),
        robot=robot.name,
        comments=tuple(comments),
        events=tuple(events),
        wiring=wiring or Wiring(),
    )


def head_lines(program: Program) -> list[str]:
    """Return the comment lines at the head of every file, with characters that every language accepts."""
    lines = [f"{program.name}: {len(program)} waypoints for {program.robot} {program.controller}".rstrip()]
    if program.unchecked:
        lines.append(f"SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN: {program.unchecked}")
    if not any(event.kind.startswith("spindle") for event in program.events):
        lines.append("no header lines: spindle and coolant are not started here")
    return [clean_text(line) for line in [*lines, *program.comments]]


def order_joints(program: Program, wanted: Sequence[str], language: str) -> list[int]:
    """Return the columns of joints with these names; refuse a controller without one of them."""
    missing = [name for name in wanted if name not in program.joint_names]
    if missing:
        own = list(program.joint_names)
        message = f"{language} programs need joints named {list(wanted)}, this controller has {own}"
        raise InputError(f"{message}; set joint_names in controller.toml")
    return [program.joint_names.index(name) for name in wanted]


def joint_shares(program: Program) -> Array:
    """Return the greatest share of its rate that a joint needs in each move; nan where unknown and for rapid moves.

    The duration of a move is the difference of `time`, otherwise distance over feed. Shape (n,).
    """
    if program.rates is None:
        return np.full(len(program), np.nan)
    share = np.max(np.abs(np.diff(program.joints, axis=0, prepend=np.nan)) / program.rates, axis=1)
    if program.time is not None:
        duration = np.diff(program.time, prepend=np.nan)
    else:
        distance = np.linalg.norm(np.diff(program.tcp[:, :3, 3], axis=0, prepend=np.nan), axis=1) * 1e3
        duration = distance / np.where(program.feed > 0.0, program.feed, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = share / duration
    return np.where(np.isfinite(shares) & ~program.rapid, shares, np.nan)


def joint_percent(program: Program, rapid: float = 100.0, least: float = 1.0) -> Array:
    """Return each move's percentage of the joint rates, `rapid` for rapid moves, 10 where unknown. Shape (n,). [%]"""
    shares = joint_shares(program)
    return np.clip(np.where(program.rapid, rapid, np.where(np.isfinite(shares), 100.0 * shares, 10.0)), least, 100.0)
