"""Options of the CAM readers: the section [cam] of a job, options of `compplan convert`, and machines by name.

The position of the tool is unknown at the beginning of a program, after moves in machine coordinates (G28, G53, SUPA,
M91), after joint moves of a robot and after probing. A cut from an unknown position is refused, or begins at `from_mm`.
After a rapid move with all coordinates the position is known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from compplan.errors import InputError
from compplan.io.tomlfile import SchemaOne, StrictTable, check_table, read_toml, read_toml_model
from compplan.toolpath.readers.arcs import Point

#: A coordinate [mm].
Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Vector = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
#: Rotary axes of a machine, the carrying axis first.
Axes = Annotated[list[Literal["A", "B", "C", "-A", "-B", "-C"]], Field(min_length=1, max_length=2)]
#: File of the machines that ship with compplan.
SHIPPED = Path(__file__).with_name("machines.toml")
#: Greatest distance between an arc and its chords. [mm]
CHORD_MM = 0.001
#: Greatest turn of the tool, or of a rotary axis, between waypoints. [deg]
TURN_STEP = 1.0
WCS = r"^[Gg](54\.1|154) ?[Pp]\d{1,3}$|^[Gg](5[4-9](\.\d)?|5\d\d)$"


class MachineAxes(StrictTable):
    """Rotary axes of a machine.

    rotary_axes: rotary axes, the carrying axis first (the head axis in a head_table); "-C" for a left-hand rotation
        of the table. Default: tilt, then C on a table; C, then tilt on a head.
    rotary_centre_mm: a point on the first table axis, relative to the part zero; rotary_offset_mm: vector from there
        to the second table axis. Required for files without tool centre point control (G43.4, TRAORI, M128).
    pivot_mm: distance from the tool tip to the intersection of the head axes; required for such files too.
    tip_control: X Y Z are the tool tip in the part frame, although the file has no G43.4, TRAORI or M128.
    tilt_angles: type of the angles of cycle 19 in Heidenhain programs: spatial angles. Refused by default, since on
        some machines they are positions of the rotary axes.
    """

    rotary_axes: Axes | None = None
    rotary_centre_mm: Vector | None = None
    rotary_offset_mm: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    pivot_mm: float | None = Field(default=None, ge=0.0, le=1e5)
    tip_control: bool = False
    tilt_angles: Literal["spatial"] | None = None


class CamTable(StrictTable):
    """[cam]: options of the CAM readers.

    unit: unit of length of files that do not state it; they are refused without it.
    from_mm: start of cuts from an unknown position (at the beginning, after machine moves, after joint moves of a
        robot), in the part frame; only unknown coordinates are replaced. Such cuts are refused without it.
    feed_mm_s: feed of cutting moves without feed, or with feed 0, in the file.
    machine: name of the machine tool: its rotary axes and distances (`MachineAxes`) are in the table that ships with
        compplan (compplan doctor lists the names) or in NAME.toml in the folder of the file.
    rotary: body that the A B C words of a file rotate: the tool (head), the part (table), or both; or the words are
        ignored (ignore). A file with rotations A B C is refused without it.
    compensation: meaning of the path under cutter radius compensation (G41, G42, RL, RR): centre_line for the path of
        the tool centre, where the control compensates wear only. A contour of the part is not read: post-process the
        path of the centre. A file with compensation is refused without this key.
    wcs: work offset that is the part frame ("G54", "G54.1 P3") in a file with several; cuts in the others are left
        out.
    cycles: drilling cycles are expanded into cutting moves, or skipped: the tool moves rapidly above the holes.
    tool_direction: axis of the TCP frame that points out of the tool in robot programs (default: z, with a note).
    operation: number of the only operation that is read, from 1 (an operation: the cuts between two tool changes).
    strict: refuse a file that is read with any note.
    """

    unit: Literal["mm", "inch"] | None = None
    from_mm: Vector | None = None
    feed_mm_s: float | None = Field(default=None, gt=0.0, le=10_000.0)
    machine: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]{0,63}$")] | None = None
    rotary: Literal["head", "table", "head_table", "ignore"] | None = None
    compensation: Literal["centre_line"] | None = None
    wcs: Annotated[str, Field(pattern=WCS)] | None = None
    cycles: Literal["skip", "expand"] = "expand"
    tool_direction: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    operation: int | None = Field(default=None, ge=1)
    strict: bool = False
    _axes: MachineAxes = PrivateAttr(default=MachineAxes.model_construct())

    @property
    def axes(self) -> MachineAxes:
        """Rotary axes of the machine."""
        return self._axes


def find_start(place: Point, unknown: Iterable[int], stated: Sequence[float] | None, reason: str = "") -> Point:
    """Return the start of a cut from a position [mm] with some unknown coordinates. [mm]

    `stated` (`from_mm`) replaces unknown coordinates; without it they are refused, with the reason.
    """
    axes = sorted(set(unknown))
    if axes and stated is None:
        names = " ".join("XYZ"[axis] for axis in axes)
        why = f" ({reason})" if reason else ""
        raise InputError(
            f"a cut begins where {names} of the tool is not known{why}; add a rapid move to a known place before it, "
            "or state the start of such cuts by --from X,Y,Z ([cam] from_mm)"
        )
    found = list(place)
    for axis in axes:
        found[axis] = float((stated or place)[axis])
    return found[0], found[1], found[2]


def refuse_unit(words: str) -> InputError:
    """Return the error for a file without unit of length; `words` are those that set the unit."""
    return InputError(f"no unit of length is stated before this line ({words}): state it with --unit mm or --unit inch "
                      "([cam] unit)")  # fmt: skip


class NamedMachine(MachineAxes):
    """[machine]: rotating body (`rotary`, as in [cam]), rotary axes and a descriptive `title`."""

    title: str = ""
    rotary: Literal["head", "table", "head_table"]


class MachineFile(StrictTable):
    """File of a user-defined machine."""

    schema_: SchemaOne = Field(alias="schema")
    machine: NamedMachine


@lru_cache(maxsize=1)
def list_machines() -> dict[str, NamedMachine]:
    """Return the machines that ship with compplan, by name."""
    tables = {name: table for name, table in read_toml(SHIPPED).items() if name != "schema"}
    return {name: check_table(NamedMachine, table, file=SHIPPED, key=name) for name, table in tables.items()}


def use_machine(options: CamTable, file: Path) -> CamTable:
    """Return options with the rotary axes of their machine, from NAME.toml in the folder of the file or as shipped.

    A stated `rotary` is kept.
    """
    name = options.machine
    if name is None:
        return options
    own, shipped = file.with_name(f"{name}.toml"), list_machines()
    if not own.is_file() and name not in shipped:
        raise InputError(f"no machine named {name!r}, choose from {', '.join(shipped)}, or write {name}.toml "
                         "beside the CAM file", where="cam.machine")  # fmt: skip
    machine = read_toml_model(MachineFile, own).machine if own.is_file() else shipped[name]
    options = options.model_copy(update={"rotary": options.rotary or machine.rotary, "machine": None})
    options._axes = machine
    return options
