"""Shared parts of all language modules: kinds of programs, division into files, moves row by row."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from compplan.controllers.writers.fit import Fitted, fit_moves
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, render_post
from compplan.controllers.writers.program import Program, head_lines, joint_percent
from compplan.controllers.writers.text import LANGUAGES, legal_name
from compplan.controllers.writers.zones import OTHER, ZONES, find_zones, mark_narrow
from compplan.errors import InputError
from compplan.io.tables import Array, write_text


class WrittenMove(NamedTuple):
    """A move of a program, with the numbers of a language."""

    row: int  #: Row of the program at the end of the move.
    kind: str  #: "joint", "line" or "arc".
    stops: bool  #: Whether the robot stops at its end.
    swings: bool  #: Whether it is a joint move among lines, due to a configuration change.
    feed: float  #: [mm/s]
    percent: float  #: Share of the joint rates. [%]
    arm: list[float]  #: Joints of the arm. [deg]
    outer: list[float]  #: Joints that slide or carry the part (external axes). [mm or deg]
    place: list[float]  #: Pose of its end in the part frame; empty in joint programs.
    via: list[float]  #: Via pose of an arc; empty otherwise.
    zone: float  #: Zone that the program must state, infinite where the language's default suffices. [m]
    default_zone: float  #: Default zone of the language. [m]


@dataclass(frozen=True)
class ProgramPart:
    """The moves of one file."""

    program: Program  #: The complete program; for tool moves, reduced to the ends of its moves.
    whole: str  #: Name of the program.
    name: str  #: Name of this part.
    parts: Mapping[str, slice]  #: Rows of all parts, by their names.
    rows: slice  #: Rows of this part.
    linear: bool  #: Whether the moves are tool moves; otherwise joint moves.
    every: list[WrittenMove]  #: All moves of the program.
    events: Mapping[int, list[str]]  #: Lines of events (no motion), by the row that they follow.

    @property
    def moves(self) -> list[WrittenMove]:
        """The moves of this file."""
        return self.every[self.rows]

    def merge_events(self, lines: Sequence[Sequence[str]], indent: str = "") -> list[str]:
        """Return the lines of each move, followed by the lines of the events after it."""
        woven = list(self.events.get(-1, [])) if self.rows.start == 0 else []
        for move, own in zip(self.moves, lines, strict=True):
            woven += [*own, *self.events.get(move.row, [])]
        return [indent + line for line in woven]

    def render(self, language: str, **words: object) -> str:
        """Return the text of a language's template, with these words and those common to all templates."""
        program = self.program
        known = {"name": self.name, "parts": [*self.parts], "comments": head_lines(program), "cell": program.post.words}
        return render_post(program, language, {**known, **words})


FormatPart = Callable[[ProgramPart], dict[str, str]]


@dataclass(frozen=True)
class ProgramForm:
    """Names, files, phrases (languages.toml), number format of poses, and texts of a language's programs."""

    language: str  #: Name of its file.
    #: Conversion of poses to the numbers of the language. Shape (n, 4, 4) [m] -> (n, k).
    numbers: Callable[[Array], Array]
    format_part: FormatPart  #: Texts of a part by file name.
    #: Texts of the program that calls the parts, from a part without rows; None where there is no such program.
    format_calls: FormatPart | None
    phrases: Phrases  #: Phrases for events.
    cell: CellWords  #: Tool and frame data of a cell that it can call.
    title: str  #: Name of the language in messages.
    longest: int  #: Greatest number of letters of a name, without its ending and the number of a part.
    most: int  #: Default number of points in a file.
    brand: str = ""  #: Brand of its controllers, "" for several brands.
    moves_part: bool = False  #: Whether its programs move joints that carry the part.
    reserved: Collection[str] = ()  #: Reserved words that cannot be names.
    letters: str = ""  #: Case of names: "upper", "lower", "" unchanged.
    two_letters: bool = False  #: Whether names begin with two letters, or a letter and _.
    endings: Sequence[str] = ("", "_L")  #: Endings of the names of joint and linear programs.
    between: str = "_"  #: Separator before the number of a part.
    single: bool = False  #: Whether a program of one part is written without a main program.
    numbered: bool = True  #: Whether names keep letters free for the number of a part.
    arcs: bool = True  #: Whether the language has arcs.
    carried_arcs: bool = True  #: Whether it has arcs in programs that move the part.
    narrows: bool = True  #: Whether zones can be made smaller; if not, robots stop where the default is too large.
    by_main: bool = True  #: Whether the main program's name from the job names the files.
    newline: str = "\r\n"  #: Line ending.
    percents: Sequence[float] = (100.0, 1.0)  #: Share of the joint rates in rapid moves, and least one. [%]
    suffix: str = ""  #: File extension of programs that call others, "" if the language has no calls.
    longest_main: int = 0  #: Greatest number of letters of the name of a multi-tool main program; 0: `longest`.

    @classmethod
    def load(
        cls, language: str, numbers: Callable[[Array], Array], format_part: FormatPart,
        format_calls: FormatPart | None = None,
    ) -> ProgramForm:  # fmt: skip
        """Return the form of a language of languages.toml."""
        table = {key: value for key, value in LANGUAGES[language].items() if key in cls.__dataclass_fields__}
        table |= {"phrases": Phrases(**table["phrases"]), "cell": CellWords(**table.get("cell", {}))}
        return cls(language, numbers, format_part, format_calls, **table)

    def write(self, program: Program, folder: Path, most: int | None, *, can: bool) -> list[Path]:
        """Write the joint program and, where the language `can`, the linear one; return the files."""
        points = most or self.most
        name = self.name_program(program, points)
        texts: dict[str, str] = {}
        if program.form != "linear" or not can:
            texts |= self.format_kind(program, name, points, linear=False)
        if can and program.form != "joint":
            fitted = self.fit(program).program
            if not self.narrows:  # stop where the default zone is too large
                fitted = replace(fitted, exact=fitted.stops(linear=True) | mark_narrow(fitted, self.language))
            texts |= self.format_kind(fitted, name, points, linear=True)
        return write_texts(folder, texts, self.newline)

    def fit(self, program: Program) -> Fitted:
        """Return the program reduced to the ends of the tool moves that the language writes."""
        return fit_moves(program, arcs=self.arcs and (self.carried_arcs or not program.moves_part))

    def name_program(self, program: Program, most: int) -> str:
        """Return the name of a program, without its ending."""
        room = len(str(max(1, -(-len(program) // max(most, 1))))) if self.numbered else 0
        own = (self.by_main and program.post.main) or program.name
        name = legal_name(own, self.longest - room, reserved=self.reserved)
        if self.two_letters and (len(name) < 2 or name[1].isdigit()):
            name = f"p_{name}"
        return {"upper": name.upper(), "lower": name.lower()}.get(self.letters, name)

    def divide(self, name: str, count: int, most: int) -> dict[str, slice]:
        """Return the rows of each part by name: parts of nearly equal length, at most `most` rows each."""
        if most < 1:
            raise InputError(f"max_points_per_file is {most}, expected at least 1")
        edges = np.linspace(0, count, max(1, -(-count // most)) + 1).round().astype(int).tolist()
        if self.single and len(edges) == 2:
            return {name: slice(0, count)}
        return {f"{name}{self.between}{k}": slice(*rows) for k, rows in enumerate(pairwise(edges), start=1)}

    def format_kind(self, program: Program, name: str, most: int, *, linear: bool) -> dict[str, str]:
        """Return the files of a joint program, or of a linear one, by file name."""
        program = replace(program, post=check_cell(program.post, self.cell, self.title))
        # a single program that is named by the job has no ending
        whole = name if self.by_main and program.post.main else f"{name}{self.endings[linear]}"
        parts = self.divide(whole, len(program), most)
        moves = list_moves(program, self, linear=linear)
        events = phrase_events(program.events, program.wiring, self.phrases, self.title)
        texts: dict[str, str] = {}
        for part, rows in parts.items():
            texts |= self.format_part(ProgramPart(program, whole, part, parts, rows, linear, moves, events))
        if self.format_calls and (len(parts) > 1 or not self.single):
            texts |= self.format_calls(ProgramPart(program, whole, whole, parts, slice(0, 0), linear, moves, {}))
        return texts


def write_texts(folder: Path, texts: Mapping[str, str], newline: str) -> list[Path]:
    """Write texts by file name; return the files."""
    for name, text in texts.items():
        write_text(folder / name, text, newline=newline)
    return [folder / name for name in texts]


def list_moves(program: Program, form: ProgramForm, *, linear: bool) -> list[WrittenMove]:
    """Return the moves of a program (fitted, for tool moves) with the numbers of a language."""
    n = len(program)
    alone, stops = program.alone(linear=linear), program.stops(linear=linear)
    arcs = program.arcs & ~alone if linear else np.zeros(n, bool)
    kind = np.where(alone | (not linear), "joint", np.where(arcs, "arc", "line"))
    places = form.numbers(program.positions).tolist() if linear else [[]] * n
    through = form.numbers(program.via_positions[arcs]).tolist() if arcs.any() else []
    vias = dict(zip(np.flatnonzero(arcs).tolist(), through, strict=True))
    zones = own = np.full(n, np.inf)
    if linear:
        _, zones, own = find_zones(program, ZONES.get(form.language, OTHER))
    columns = (
        kind, stops, program.swings & linear, program.feed, joint_percent(program, *form.percents),
        program.joints[:, ~program.outer], program.joints[:, program.outer],
    )  # fmt: skip
    values = zip(*(column.tolist() for column in columns), places, strict=True)
    return [
        WrittenMove._make([row, *value, vias.get(row, []), zone, whole])
        for row, (value, zone, whole) in enumerate(zip(values, zones.tolist(), own.tolist(), strict=True))
    ]


def change(modal: dict[str, str], key: str, word: str) -> list[str]:
    """Return a modal command in a list where it differs from the current one, and store it; otherwise an empty list."""
    if not word or modal.get(key) == word:
        return []
    modal[key] = word
    return [word]


def describe_feeds(program: Program, steps: str, state: Callable[[Array], Array]) -> list[str]:
    """Return a note where a language rounds feeds to steps and some [mm/s] are off by more than 1 %."""
    moves = fit_moves(program).program
    wrong = ~moves.rapid & (np.abs(state(moves.feed) - moves.feed) > 0.01 * moves.feed)
    if not wrong.any():
        return []
    count, slowest = int(np.count_nonzero(wrong)), moves.feed[wrong].min()
    return [f"feeds are written in steps of {steps}: {count} are off by more than 1 %, the slowest is {slowest:g} mm/s"]


def need_six_axes(program: Program, language: str, *, sliding: int) -> None:
    """Refuse a robot without exactly six rotating joints, or with more sliding joints than the language supports."""
    slides = int(program.outer.sum())
    if program.moves_part or len(program.joint_names) - slides != 6 or slides > sliding:
        rail = f" and up to {sliding} sliding" if sliding else ""
        own = list(program.joint_names)
        raise InputError(f"{language} programs are written for six rotating{rail} joints, this robot has {own}")
