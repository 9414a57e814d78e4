"""The main program of a job of several tools: it calls the programs of each in order, where the language has calls."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from compplan.files.tables import read_text, write_text
from compplan.program.fanuc_ls import format_program
from compplan.program.inform import format_job
from compplan.program.program import Program, head_lines
from compplan.program.text import legal_name

#: Letters that a main program adds to the name of the job: _ALL, and _L for linear moves.
ADDED = 6


def _format_krl(name: str, program: Program, calls: Sequence[str]) -> str:
    head = [f"; {line}" for line in head_lines(program)]
    return "\n".join(["&ACCESS RVO", f"DEF {name}()", *head, *(f"{call}()" for call in calls), "END", ""])


def _format_fanuc(name: str, program: Program, calls: Sequence[str]) -> str:
    return format_program(name, program, [f"  CALL {call} ;" for call in calls], [])


def _format_inform(name: str, program: Program, calls: Sequence[str]) -> str:
    return format_job(program, name, [], [f"CALL JOB:{call}" for call in calls])


def _format_kawasaki(name: str, program: Program, calls: Sequence[str]) -> str:
    head = [f"  ; {line}" for line in head_lines(program)]
    return "\n".join([f".PROGRAM {name}()", *head, *(f"  CALL {call}" for call in calls), ".END", ""])


def _format_sinumerik(name: str, program: Program, calls: Sequence[str]) -> str:
    return "\n".join([*(f"; {line}" for line in head_lines(program)), *calls, "M30", ""])


Format = Callable[[str, Program, Sequence[str]], str]
#: Languages with calls: the ending of their programs, the letters of a name, the text. RAPID modules and VAL3 programs
#: are loaded with a main program of their own each, URScript has no calls of other files.
FORMS: dict[str, tuple[str, int, Format]] = {
    "krl": (".src", 22, _format_krl), "fanuc_ls": (".LS", 26, _format_fanuc), "inform": (".JBI", 28, _format_inform),
    "kawasaki_as": (".as", 12, _format_kawasaki), "sinumerik": (".MPF", 23, _format_sinumerik),
}  # fmt: skip
#: What the name of a main program ends in.
WHOLE = re.compile(r"_ALL(_[JL])?$", re.IGNORECASE)
#: Endings of names that say how a program moves: the joints, or the tool.
KINDS = re.compile(r"_[JjLl]$")


def write_sequence(
    program: Program, language: str, name: str, groups: Sequence[Sequence[Path]], folder: Path
) -> list[Path]:
    """Write the main program of a job of several tools in a language, one for joint moves and one for linear ones.

    Args:
        program: The program of the first tool, for the head.
        language: Language of the programs.
        name: Name of the job.
        groups: Files that were written for each tool, in the order in which they run.
        folder: Folder to write to.

    Returns:
        The files written; none where the language has no calls of other programs.

    """
    if language not in FORMS or len(groups) < 2:
        return []
    suffix, longest, form = FORMS[language]
    entries = [_find_entries([file for file in files if file.suffix == suffix]) for files in groups]
    files = []
    for kind in entries[0]:
        if all(kind in entry for entry in entries):
            calls = [entry[kind] for entry in entries]
            whole = f"{legal_name(name, longest - ADDED)}_ALL{kind}"
            upper, lower = calls[0].isupper(), calls[0].islower()
            whole = whole.upper() if upper else whole.lower() if lower else whole
            files.append(folder / f"{whole}{suffix}")
            write_text(files[-1], form(whole, program, calls), newline="\n" if language == "sinumerik" else "\r\n")
    return files


def _find_entries(files: Sequence[Path]) -> dict[str, str]:
    """Return the programs of a tool that no other one calls, by the ending that says how they move."""
    texts = {file.stem: read_text(file) for file in files}
    called = {
        stem for stem in texts
        if any(re.search(rf"(?<!\w){re.escape(stem)}(?!\w)", _body(text)) for own, text in texts.items() if own != stem)
    }  # fmt: skip
    entries = [stem for stem in texts if stem not in called]
    return {found.group() if (found := KINDS.search(stem)) else "": stem for stem in entries}


def _body(text: str) -> str:
    """Return a program without its comments."""
    return re.sub(r"(?m)(;[^\n]*|^\s*\d*:?\s*!.*|^'.*)$", "", text)
