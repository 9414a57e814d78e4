"""Native robot programs, one module for each language."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.joint_convention import load_controller
from compplan.controllers.writers.language import ProgramForm, ProgramPart, write_texts
from compplan.controllers.writers.machine import Wiring, describe_events
from compplan.controllers.writers.post import check_cell, describe_cell, render_own
from compplan.controllers.writers.program import Program, build_program, head_lines
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import OTHER, ZONES, BlendZone, mark_narrow
from compplan.errors import InputError, UnknownNameError
from compplan.io.notes import Stop
from compplan.io.registry import Registry
from compplan.robot import Robot


class Language(Protocol):
    """Interface of a language module.

    Optional: `FORM` (a `ProgramForm` from languages.toml) and `describe` (notes on a program for the user).
    """

    name: str

    def write(self, program: Program, folder: Path, most: int | None = None) -> list[Path]:
        """Write a program into a folder, with at most `most` points in a file (left out: the language's default).

        Raises:
            InputError: If the robot's joints, or the data on them, do not fit the language.
        """


_OWN = ("krl", "val3", "fanuc_ls", "rapid", "urscript", "sinumerik", "inform", "kawasaki_as", "own", "csv")
#: Every language, by the name of its module.
WRITERS: Registry[Language] = Registry[Language](_OWN, __name__)

#: Letters that a main program adds to the job name: _ALL, and _L for linear moves.
ADDED = 6
#: Ending of the name of a main program.
WHOLE = re.compile(r"_ALL(_[JL])?$", re.IGNORECASE)
#: Endings of program names: joint moves or moves of the tool.
KINDS = re.compile(r"_[JjLl]$")

__all__ = [
    "WHOLE", "WRITERS", "Program", "Wiring", "build_program", "check_brand", "check_languages", "describe_program",
    "find_ends", "widest_zone", "write_program", "write_sequence",
]  # fmt: skip


def write_program(
    program: Program, language: str, folder: str | Path, *, most: int | None = None, any_brand: bool = False
) -> list[Path]:
    """Write a program in a controller's language.

    Args:
        program: The program.
        language: One of `WRITERS`.
        folder: Folder to write to; made if needed.
        most: Greatest number of points in a file; left out: the language's default.
        any_brand: Whether to accept a language of another brand than the robot's controller.

    Returns:
        The files written.

    Raises:
        UnknownNameError: If there is no such language.
        InputError: If the program does not fit the language, or the folder cannot be written.
    """
    if language not in WRITERS:
        raise UnknownNameError("program language", language, list(WRITERS))
    if not any_brand:
        check_brand(program.controller, language)
    return WRITERS[language].write(program, Path(folder), most)


def find_ends(program: Program, language: str) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """Return the rows where a language's tool moves end, and those where it stops because it lacks a smaller zone.

    Shapes (k,).
    """
    form = WRITERS[language].FORM  # type: ignore[attr-defined]
    fitted = form.fit(program)
    return fitted.rows, np.zeros(len(fitted.rows), bool) if form.narrows else mark_narrow(fitted.program, language)


def widest_zone(languages: tuple[str, ...]) -> BlendZone:
    """Return the language's blend zone that departs most from the path at a corner.

    The zone of a language that is not listed is in its module (`ZONE`); otherwise it is assumed.
    """
    zones = (ZONES.get(name) or getattr(WRITERS.get(name), "ZONE", OTHER) for name in languages)
    return max(zones, key=lambda zone: (zone.size, zone.overlap))


def check_brand(controller: str, language: str) -> None:
    """Refuse a language of controllers of another brand.

    Any language is accepted for an unnamed controller, or one of a brand without a language here.

    Raises:
        InputError: If the controller is of another brand than the language.
    """
    fitting = list_languages(controller)
    if language not in fitting:
        raise InputError(
            f"{language} is the language of {_brand(language)}, the robot's controller is a {controller}, choose from "
            f"{fitting}; any_brand = true writes it anyway"
        )


def list_languages(controller: str) -> list[str]:
    """List the languages of a controller, those of its brand first; all languages where the brand is not known."""
    brands = {name: _brand(name) for name in WRITERS}
    own = {brand for brand in brands.values() if brand and brand.lower() in controller.lower()}
    languages = [name for name, brand in brands.items() if not own or not brand or brand in own]
    return sorted(languages, key=lambda name: brands[name] not in own)


def check_languages(
    robot: Robot, languages: Sequence[str], *, file: Path, form: str = "both", any_brand: bool = False
) -> None:
    """Refuse a job with programs that cannot be written for its robot, before it is planned.

    Raises:
        InputError: If a language is of another brand or does not support the joints or controller.toml of the robot, or
            if controller.toml is not valid.
    """
    controller = load_controller(robot).name if languages else ""
    moving = [name for name in WRITERS if name == "csv" or ((own := _form(name)) is not None and own.moves_part)]
    for language in languages:
        if robot.ground and language not in moving:
            message = f"{language} programs cannot move what carries the part, choose from {moving}"
            raise InputError(message, file=file, where="output.programs")
        try:
            if not any_brand:
                check_brand(controller, language)
            if language != "own":  # its template decides what it supports
                _check_writable(robot, language, form)
        except InputError as error:
            if error.file is not None:
                raise
            raise InputError(error.message, file=file, where="output.programs") from None


def _check_writable(robot: Robot, language: str, form: str) -> None:
    """Write two waypoints amid the joint limits into a temporary folder, to raise the errors of the language."""
    low, high = (np.where(np.isfinite(limit), limit, 0.0) for limit in (robot.lower, robot.upper))
    q = 0.5 * (low + high) + np.array([[0.0], [1e-3]])
    program = build_program(robot, q, np.full(2, 0.01), np.array([True, False]), name="rehearsal")
    with TemporaryDirectory() as folder:
        WRITERS[language].write(replace(program, form=form), Path(folder), None)


def describe_program(program: Program, language: str) -> list[str]:
    """Return the notes on a program in a language, one sentence each."""
    notes: list[str] = []
    if program.unchecked:
        notes.append(Stop(
            f"{language}: SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN: {program.unchecked}; "
            "check every axis against the controller's display"
        ))  # fmt: skip
    swings = np.flatnonzero(program.swings).tolist()
    if swings and language != "csv":
        where = f"{', '.join(map(str, swings[:5]))}{' ...' if len(swings) > 5 else ''}"
        notes.append(Stop(f"{language}: the arm flips (shoulder, elbow or wrist) during the cut at waypoints {where}: "
                          "do not run the linear program"))  # fmt: skip
    module = WRITERS[language]
    describe, form = getattr(module, "describe", None), _form(language)
    own = list(describe(program)) if describe else []
    if form is not None:
        own += [*describe_cell(program.post, form.cell), *describe_events(program.events, program.wiring, form.phrases)]
    elif any(event.kind != "comment" for event in program.events):
        own.append("spindle, coolant, dwells and stops of the CAM file are not in this table")
    return [*notes, *(type(note)(f"{language}: {note}") for note in own)]


def write_sequence(
    program: Program, language: str, name: str, groups: Sequence[Sequence[Path]], folder: Path
) -> list[Path]:
    """Write the main programs of a job of several tools: one for joint moves and one for linear moves.

    `groups` are the files written for each tool, in order of execution. Nothing is written where the language cannot
    call other programs.
    """
    form = _form(language)
    if form is None or not form.suffix or len(groups) < 2:
        return []
    entries = [_find_entries([file for file in files if file.suffix == form.suffix]) for files in groups]
    post = replace(check_cell(program.post, form.cell, form.title), overwrite=False)
    texts: dict[str, str] = {}
    for kind in entries[0]:
        if all(kind in entry for entry in entries):
            calls = [entry[kind] for entry in entries]
            whole = f"{legal_name(name, (form.longest_main or form.longest) - ADDED)}_ALL{kind}"
            upper, lower = calls[0].isupper(), calls[0].islower()
            whole = whole.upper() if upper else whole.lower() if lower else whole
            if form.calls_sequence and form.format_calls:
                none, parts, first = slice(0, 0), dict.fromkeys(calls, slice(0, 0)), replace(program, post=post)
                texts |= form.format_calls(ProgramPart(first, whole, whole, parts, none, False, [], {}, sequence=True))
            else:
                words = {"name": whole, "comments": head_lines(program), "lines": [], "calls": calls}
                texts[f"{whole}{form.suffix}"] = render_own(f"{language}_main", words)
    return write_texts(folder, texts, form.newline)


def _find_entries(files: Sequence[Path]) -> dict[str, str]:
    """Return the top-level programs of a tool (not parts of another one), by the ending for their kind of moves."""
    stems = [file.stem for file in files]
    parts = {stem for stem in stems for whole in stems if re.fullmatch(rf"{re.escape(whole)}_?\d+", stem)}
    return {found.group() if (found := KINDS.search(stem)) else "": stem for stem in stems if stem not in parts}


def _form(language: str) -> ProgramForm | None:
    return getattr(WRITERS[language], "FORM", None)


def _brand(language: str) -> str:
    form = _form(language)
    return "" if form is None else form.brand
