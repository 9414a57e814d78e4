"""What stands around the moves of a program: a Jinja template a language, and one of a user's own in its place.

A template gets the words of its language's writer; docs/programs.md names them. They are plain data (tables, lists,
text, numbers) and the template runs in a sandbox that changes none of them, so that a template of another person
cannot reach a file or a program. An unknown word is an error, and what comes out has to be plain ASCII in lines that
the controller takes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.controllers.writers.program import Post, Program
from compplan.controllers.writers.text import LANGUAGES
from compplan.errors import InputError
from compplan.io.notes import Stop
from compplan.io.tables import read_text

if TYPE_CHECKING:
    from jinja2 import Environment

#: Letters of a line that a controller takes where languages.toml does not say (assumed).
LONGEST_LINE = 1000


@dataclass(frozen=True)
class CellWords:
    """What a language can call of a cell by itself: "number" or "name" for tool and frame, "" where it has none."""

    tool: str = ""
    base: str = ""
    #: Numbers of tool and frame where a job names none: languages whose programs always count from numbered ones.
    numbers: Mapping[str, int | str] = field(default_factory=dict)


def check_cell(post: Post, cell: CellWords, language: str) -> Post:
    """Return what a job asks for with the numbers that a language needs in any case.

    Raises:
        InputError: If the job names tool or frame in a way that the language does not know.
    """
    for key, kind in (("tool", cell.tool), ("base", cell.base)):
        value = getattr(post, key)
        if value is None:
            continue
        if not kind:
            raise InputError(f"output.cell {key} is {value!r}, {language} programs hold their own")
        if not (isinstance(value, int) if kind == "number" else isinstance(value, str) and value.isidentifier()):
            word = "a number" if kind == "number" else "a name of the cell's"
            raise InputError(f"output.cell {key} is {value!r}, {language} takes {word}")
    named = {key: value for key, value in cell.numbers.items() if getattr(post, key) is None}
    return Post(**{**vars(post), **named})


def describe_cell(post: Post, cell: CellWords) -> list[Stop]:
    """Return what has to be settled at the machine where programs count from the cell's own data."""
    if post.overwrite:
        return []
    named = {"tool": post.tool, "frame": post.base}
    numbers = {"tool": cell.numbers.get("tool"), "frame": cell.numbers.get("base")}
    kept = {key: numbers[key] if value is None else value for key, value in named.items()}
    data = " and ".join(f"{key} {value}" for key, value in kept.items() if value is not None)
    return [Stop(f"{data} of the cell have to hold the values that the head of the program states")] if data else []


def name_main(program: Program) -> str:
    """Return the name that a job gives its main program, else that of the program."""
    return program.post.main or program.name


def render_post(program: Program, language: str, words: Mapping[str, Any]) -> str:
    """Return the text that a language's template, or the user's own, makes of a program.

    Raises:
        InputError: If the template is not one, uses a word that there is not, or makes lines that controllers refuse.
    """
    from jinja2 import TemplateError

    own = program.post.template
    text = read_post(language) if own is None else read_text(own)
    data = to_plain(words)
    try:
        made = _environment().from_string(text).render(data)
    except TemplateError as error:
        line = getattr(error, "lineno", None)
        raise InputError(f"is no template of {language}: {error.message or error}", file=own, where=line) from None
    except (TypeError, ValueError, LookupError, ArithmeticError, AttributeError, RecursionError) as error:
        raise InputError(f"is no template of {language}: {error}", file=own) from None
    if not made.isascii() or "\0" in made:
        raise InputError(f"makes letters of {language} that no program takes, expected plain ASCII", file=own)
    longest = LANGUAGES.get(language, {}).get("longest_line", LONGEST_LINE)
    for number, line in enumerate(made.split("\n"), start=1):
        if len(line) > longest:
            message = f"line {number} of a {language} program has {len(line)} letters, at most {longest}"
            raise InputError(message, file=own)
    return made


def render_own(name: str, words: Mapping[str, Any]) -> str:
    """Return the text that a template of the package, which no user replaces, makes of some words."""
    return _environment().from_string(read_post(name)).render(to_plain(words))


def read_post(language: str) -> str:
    """Return the package's template of a language."""
    file = files(__package__) / "posts" / f"{language}.jinja"
    if not file.is_file():
        raise InputError(f"there is no template of {language}")
    return file.read_text(encoding="utf-8")


def to_plain(words: Mapping[str, Any]) -> Any:
    """Return words as tables, lists, text, numbers, truth values and None, all that a template may hold.

    The cell's own template file is left out: its path is an object with methods that write files. Other types are
    refused.
    """
    return json.loads(json.dumps(words, default=_flatten))


def _flatten(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {key: entry for key, entry in vars(value).items() if key != "template"}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no plain data for a template")


@cache
def _environment() -> Environment:
    from jinja2 import StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    return ImmutableSandboxedEnvironment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False
    )
