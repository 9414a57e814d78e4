"""What a CAM file does not say by itself: the [cam] table of a job, and the options of `compplan convert`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from compplan.files.tomlfile import StrictTable


class CamTable(StrictTable):
    """[cam]: how a CAM file is read.

    unit: unit of files that do not say it (left out: millimetres, with a note).
    chord_tolerance_mm: greatest distance between an arc and its chords.
    arc_centres: how G-code I J K count in files that do not say it (left out: incremental, unless only another reading
        puts every arc of the file on a circle; then with a note).
    circle_sense: how the axis of an APT CIRCLE tells the sense (auto: as the words of the record say).
    rotary: how A B C words turn the tool axis in a file that moves the tool tip in the part frame: the axes turn the
        head, or the table, or are left out.
    cycles: drilling cycles are skipped, the tool moves rapidly above the holes, or expanded into cutting moves.
    tilt_angles: what cycle 19 of Heidenhain programs states: spatial angles (left out: refused, since some machines
        take angles of their rotary axes).
    tool_direction: axis of the TCP frame that points out of the tool in robot programs (left out: z, with a note).
    operation: which operation of the file alone is read, counted from 1 (what is cut between two tool changes).
    strict: a file that is read with any note is refused.
    """

    unit: Literal["mm", "inch"] | None = None
    chord_tolerance_mm: float = Field(default=0.001, ge=1e-6, le=10.0)
    arc_centres: Literal["incremental", "absolute", "reversed"] | None = None
    circle_sense: Literal["auto", "right_hand", "left_hand"] = "auto"
    rotary: Literal["head", "table", "ignore"] = "head"
    cycles: Literal["skip", "expand"] = "skip"
    tilt_angles: Literal["spatial"] | None = None
    tool_direction: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    operation: int | None = Field(default=None, ge=1)
    strict: bool = False
