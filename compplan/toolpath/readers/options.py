"""What a CAM file does not say by itself: the [cam] table of a job, options of `compplan convert`, machines by name.

A program leaves the tool's place open at its beginning, after moves to the machine's home (G28, G53, SUPA, M91), after
joint moves of a robot and after probing. A cut from there is refused, or begins at the place that `from_mm` states. A
rapid move to a place that the program states in full makes it known.
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
#: Rotary axes of a machine, that which carries the other first.
Axes = Annotated[list[Literal["A", "B", "C", "-A", "-B", "-C"]], Field(min_length=1, max_length=2)]
#: Machines that ship.
SHIPPED = Path(__file__).with_name("machines.toml")
#: Greatest distance between an arc and its chords. [mm]
CHORD_MM = 0.001
WCS = r"^[Gg](54\.1|154) ?[Pp]\d{1,3}$|^[Gg](5[4-9](\.\d)?|5\d\d)$"


class MachineAxes(StrictTable):
    """Rotary axes of a machine.

    rotary_axes: the rotary axes, that which carries the other first (in a head_table the head's first); "-C" for a
        table that turns against the right hand. Left out: tilt and then C on a table, C and then tilt on a head.
    rotary_centre_mm: a point of the first table axis, as seen from the part zero, and rotary_offset_mm: from there to
        the second table axis. Files without control of the tip (G43.4, TRAORI, M128) need it.
    pivot_mm: from the tip of the tool to where the axes of the head meet; such files need it too.
    tip_control: X Y Z are the tip in the part frame though the file has no G43.4, TRAORI or M128.
    tilt_angles: what cycle 19 of Heidenhain programs states: spatial angles (left out: refused, since some machines
        take angles of their rotary axes).
    """

    rotary_axes: Axes | None = None
    rotary_centre_mm: Vector | None = None
    rotary_offset_mm: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    pivot_mm: float | None = Field(default=None, ge=0.0, le=1e5)
    tip_control: bool = False
    tilt_angles: Literal["spatial"] | None = None


class CamTable(StrictTable):
    """[cam]: how a CAM file is read.

    unit: unit of files that do not say it; such a file is refused without it.
    from_mm: where cuts begin whose start the file leaves open (at its beginning, after the machine's home, after joint
        moves of a robot), in the part frame; only unknown coordinates are taken. Such a cut is refused without it.
    feed_mm_s: feed of cutting moves for which the file states none, or 0.
    machine: name of the machine that the file is made for: its rotary axes and distances (`MachineAxes`) stand under
        that name in the table that ships (compplan doctor lists it) or in NAME.toml beside the file.
    rotary: what the A B C words of a file turn: the tool (head), the part (table), or both; or they are left out
        (ignore). A file whose A B C turn something is refused without it.
    compensation: what is written where the control compensates the radius of the cutter (G41, G42, RL, RR): the path of
        the tool's centre, the control adding wear alone (centre_line). A contour of the part is not read: whoever has
        one writes the centre's path. A file that compensates is refused without it.
    wcs: the work offset that is the part frame ("G54", "G54.1 P3") in a file that cuts in several; the cuts in others
        are left out.
    cycles: drilling cycles are expanded into cutting moves, or skipped: the tool moves rapidly above the holes.
    tool_direction: axis of the TCP frame that points out of the tool in robot programs (left out: z, with a note).
    operation: which operation of the file alone is read, counted from 1 (what is cut between two tool changes).
    strict: a file that is read with any note is refused.
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
    _axes: MachineAxes = PrivateAttr(default=MachineAxes())

    @property
    def axes(self) -> MachineAxes:
        """The rotary axes of the machine."""
        return self._axes


def find_start(place: Point, unknown: Iterable[int], stated: Sequence[float] | None, reason: str = "") -> Point:
    """Return where a cut begins, of a place [mm] whose coordinates of some axes are not known. [mm]

    `stated` (`from_mm`) takes the place of unknown coordinates; without it they are refused, with the reason.
    """
    axes = sorted(set(unknown))
    if axes and stated is None:
        names = " ".join("XYZ"[axis] for axis in axes)
        why = f" ({reason})" if reason else ""
        raise InputError(
            f"a cut begins where {names} of the tool is not known{why}; let a rapid move to a place in the part come "
            "first, or state where such cuts begin with --from X,Y,Z ([cam] from_mm)"
        )
    found = list(place)
    for axis in axes:
        found[axis] = float((stated or place)[axis])
    return found[0], found[1], found[2]


def refuse_unit(words: str) -> InputError:
    """Return the error that a file states no unit of length by the words that would state it."""
    return InputError(f"no unit of length is stated before this line ({words}): state it with --unit mm or --unit inch "
                      "([cam] unit)")  # fmt: skip


class NamedMachine(MachineAxes):
    """[machine]: what turns (`rotary`, as in [cam]), and the rotary axes; `title` says what it is."""

    title: str = ""
    rotary: Literal["head", "table", "head_table"]


class MachineFile(StrictTable):
    """A machine in a file of one's own."""

    schema_: SchemaOne = Field(alias="schema")
    machine: NamedMachine


@lru_cache(maxsize=1)
def list_machines() -> dict[str, NamedMachine]:
    """Return the machines that ship with compplan, by name."""
    tables = {name: table for name, table in read_toml(SHIPPED).items() if name != "schema"}
    return {name: check_table(NamedMachine, table, file=SHIPPED, key=name) for name, table in tables.items()}


def use_machine(options: CamTable, file: Path) -> CamTable:
    """Return options with the machine that they name: one that ships, or NAME.toml beside the file, which comes first.

    A stated `rotary` stays.
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
