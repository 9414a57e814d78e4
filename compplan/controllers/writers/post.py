"""Text around the moves of a program: a Jinja template for each language, which a user's template can replace.

A template gets the words of its language's writer; docs/programs.md lists them. They are plain data (tables, lists,
text, numbers). The template runs in a sandbox and cannot change them, so a template by a third party cannot access
files or programs. An unknown word is an error; the result must be plain ASCII, in lines not longer than the controller
accepts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from compplan.controllers.writers.program import Post, Program
from compplan.controllers.writers.text import LANGUAGES
from compplan.errors import InputError
from compplan.io.notes import Stop
from compplan.io.tables import dump_json, read_text

if TYPE_CHECKING:
    from jinja2 import Template

#: Letters of a line that a controller accepts, unless languages.toml has a number (assumed).
LONGEST_LINE = 1000


@dataclass(frozen=True)
class CellWords:
    """Data of a cell that a language can call: "number" or "name" for tool and frame, "" where it cannot."""

    tool: str = ""
    base: str = ""
    #: Default numbers of tool and frame, in languages whose programs always refer to numbered ones.
    numbers: Mapping[str, int | str] = field(default_factory=dict)


def check_cell(post: Post, cell: CellWords, language: str) -> Post:
    """Return the post settings of a job, completed by the default numbers of a language.

    Raises:
        InputError: If the job refers to tool or frame in a way that the language does not support.
    """
    for key, kind in (("tool", cell.tool), ("base", cell.base)):
        value = getattr(post, key)
        if value is None:
            continue
        if not kind:
            raise InputError(
                f"output.cell {key} is {value!r}, but {language} programs define it themselves; leave it out"
            )
        if not (isinstance(value, int) if kind == "number" else isinstance(value, str) and value.isidentifier()):
            word = "a number" if kind == "number" else "a name of the cell's"
            raise InputError(f"output.cell {key} is {value!r}, {language} takes {word}")
    named = {key: value for key, value in cell.numbers.items() if getattr(post, key) is None}
    return Post(**{**vars(post), **named})


def describe_cell(post: Post, cell: CellWords) -> list[Stop]:
    """Return a note on the data to be set at the machine, where programs refer to tool and frame of the cell."""
    if post.overwrite:
        return []
    named = {"tool": post.tool, "frame": post.base}
    numbers = {"tool": cell.numbers.get("tool"), "frame": cell.numbers.get("base")}
    kept = {key: numbers[key] if value is None else value for key, value in named.items()}
    data = " and ".join(f"{key} {value}" for key, value in kept.items() if value is not None)
    return [Stop(f"{data} of the cell have to hold the values that the head of the program states")] if data else []


def render_post(program: Program, language: str, words: Mapping[str, Any]) -> str:
    """Render a program's text with the template of the language, or of the user.

    Raises:
        InputError: If the template is invalid, uses an unknown word, or produces lines that controllers refuse.
    """
    from jinja2 import TemplateError

    own = program.post.template
    text = read_post(language) if own is None else read_text(own)
    data = to_plain(words)
    try:
        made = _compile_template(text).render(data)
    except TemplateError as error:
        line = getattr(error, "lineno", None)
        raise InputError(f"is not a template of {language}: {error.message or error}", file=own, where=line) from None
    except (TypeError, ValueError, LookupError, ArithmeticError, AttributeError, RecursionError) as error:
        raise InputError(f"is not a template of {language}: {error}", file=own) from None
    if not made.isascii() or "\0" in made:
        raise InputError(f"writes characters that {language} programs must not contain; use plain ASCII", file=own)
    longest = LANGUAGES.get(language, {}).get("longest_line", LONGEST_LINE)
    for number, line in enumerate(made.split("\n"), start=1):
        if len(line) > longest:
            message = f"line {number} of a {language} program has {len(line)} characters, at most {longest}"
            raise InputError(message, file=own)
    return made


def render_own(name: str, words: Mapping[str, Any]) -> str:
    """Render a template of the package that users cannot replace."""
    return _compile_template(read_post(name)).render(to_plain(words))


def read_post(language: str) -> str:
    """Return the package's template of a language."""
    file = files(__package__) / "posts" / f"{language}.jinja"
    if not file.is_file():
        raise InputError(f"there is no template of {language}")
    return file.read_text(encoding="utf-8")


def to_plain(words: Mapping[str, Any]) -> Any:
    """Return words as tables, lists, text, finite numbers, truth values and None, the only types in a template.

    Other types are refused (TypeError).
    """
    return json.loads(dump_json(words))


@lru_cache(maxsize=32)
def _compile_template(text: str) -> Template:
    from jinja2 import StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    environment = ImmutableSandboxedEnvironment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False
    )
    return environment.from_string(text)
