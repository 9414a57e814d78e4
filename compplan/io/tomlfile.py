"""TOML files checked against frozen pydantic models."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
)
from pydantic_core import CoreSchema, ErrorDetails
from pydantic_core.core_schema import no_info_after_validator_function

from compplan.errors import InputError, find_near
from compplan.io.parsing import GREATEST, guard_parser
from compplan.io.tables import read_text


class StrictTable(BaseModel):
    """Base class of TOML sections: unknown keys are refused, values are not converted, instances are frozen."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


#: A key of more than fifty parts, which tomllib parses in quadratic time.
KEY_WITHOUT_END = re.compile(r"\s*\[*\s*(?:[\w-]+\s*\.\s*){50}")

Model = TypeVar("Model", bound=StrictTable)


def refuse_other_types(value: object) -> object:
    """Refuse values other than integers: true and 1.0 equal 1 in Python."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"is {value!r}, expected a whole number such as 1")
    return value


#: Version of a file format.
SchemaOne = Annotated[Literal[1], BeforeValidator(refuse_other_types)]
#: TOML arrays as tuples; items stay strict.
Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
Numbers = Annotated[tuple[float, ...], Field(strict=False)]
Words = Annotated[tuple[str, ...], Field(strict=False)]


@dataclass(frozen=True)
class OneOf:
    """Accept a string that is a name of a registry at the time of the check."""

    names: Collection[str]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "enum": list(self.names)}

    def _check(self, value: str) -> str:
        if value not in self.names:
            raise ValueError(f"is {value!r}, choose from {list(self.names)}")
        return value


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as dictionaries.

    Raises:
        InputError: If the file is missing, or is not TOML (with the line).

    """
    return parse_toml(read_text(path), path)


def parse_toml(text: str, path: str | Path) -> dict[str, Any]:
    """Parse the text of a TOML file, see `read_toml`."""
    long = next((n for n, words in enumerate(text.splitlines(), 1) if KEY_WITHOUT_END.match(words)), None)
    if long is not None:
        raise InputError("is not TOML: a key has too many dots", file=path, where=long)
    with guard_parser(path, "is not TOML"):
        data = tomllib.loads(text)
    _refuse_huge(data, path, [])
    return data


def _refuse_huge(value: Any, path: str | Path, keys: list[str | int]) -> None:
    """Refuse implausibly large numbers."""
    if isinstance(value, dict | list):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            _refuse_huge(entry, path, [*keys, key])
    elif isinstance(value, int | float) and GREATEST < abs(value) < float("inf"):
        message = f"is {value:.3g} in size, at most {GREATEST:g} is read"
        raise InputError(message, file=path, where=_join(keys, ""))


def check_table(model: type[Model], data: Mapping[str, Any], *, file: str | Path | None = None, key: str = "") -> Model:
    """Check a TOML section against a model.

    Args:
        model: The model.
        data: The section from `tomllib`.
        file: File of the section, for messages.
        key: Dotted key of the section in that file, for messages.

    Raises:
        InputError: With the dotted key, if a key is unknown, missing, or has a wrong value.

    """
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        faults = error.errors()  # report a misspelt key, not the key that is missing because of it
        details = next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])
        keys, holder = _walk(details, model)
        where = _join(keys, key)
        raise InputError(_say(details, holder, where), file=file, where=where or None) from None


def read_named_table(path: str | Path, name: str) -> tuple[dict[str, Any], str]:
    """Read a named section of a TOML file, such as a job, or the whole file if it has no such section.

    Returns:
        The section, and its key in the file, "" for the whole file.

    Raises:
        InputError: If the file is missing, not TOML or empty, or the name is not that of a section.

    """
    data = read_toml(path)
    if not data:
        raise InputError(f"is empty, expected the keys of [{name}]", file=path)
    table = data.get(name, data)
    if not isinstance(table, dict):
        raise InputError(f"is {table!r}, expected a section", file=path, where=name)
    return table, name if name in data else ""


def read_toml_model(model: type[Model], path: str | Path) -> Model:
    """Read a TOML file into a model.

    Raises:
        InputError: As `read_toml` and `check_table` do.

    """
    return check_table(model, read_toml(path), file=path)


def _walk(details: ErrorDetails, model: type[BaseModel]) -> tuple[list[str | int], Any]:
    """Resolve the location of a fault in the models.

    Returns:
        The keys, and the model of the last key (or None).

    """
    keys: list[str | int] = []
    current: Any = model
    holder: Any = model
    for part in details["loc"]:
        keys.append(part)
        holder = current
        if isinstance(part, str):
            field = None if current is None else current.model_fields.get(part)
            found = [] if field is None else _models_in(field.annotation)
            current = found[0] if len(found) == 1 else None
    return keys, holder


def _models_in(annotation: Any) -> list[Any]:
    """Return the models in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in getattr(annotation, "__args__", ()) for model in _models_in(argument)]


def _join(keys: list[str | int], prefix: str) -> str:
    dotted = prefix
    for part in keys:
        dotted += f"[{part}]" if isinstance(part, int) else f".{part}" if dotted else str(part)
    return dotted


def _say(details: ErrorDetails, holder: Any, where: str) -> str:
    """Return the message of one fault."""
    kind, given, context = details["type"], repr(details.get("input")), details.get("ctx", {})
    given = given if len(given) <= 100 else f"{given[:50]}...{given[-25:]}"
    if kind == "extra_forbidden":
        if holder is None:
            return "unknown key"
        key, tables = str(details["loc"][-1]), holder.model_fields.items()
        nested = [f"{name}.{key}" for name, field in tables if key in getattr(field.annotation, "model_fields", ())]
        if nested:
            return f"unknown key; did you mean {where.removesuffix(key)}{' or '.join(nested)}?"
        names = [field.alias or name for name, field in tables]
        return f"unknown key, choose from {list(dict.fromkeys(find_near(key, names) + names))}"
    if kind == "missing":
        return "missing number" if isinstance(details["loc"][-1], int) else "missing key"
    if kind == "model_type":
        return f"is {given}, must be a section of keys; give one of them, such as {where}.KEY = VALUE"
    if kind == "literal_error":
        return f"is {given}, choose from {context.get('expected')}"
    if kind == "value_error":
        return str(context.get("error", details["msg"]))
    if kind == "string_unicode":
        return f"is {given}, not UTF-8, which no job can hold; rename it"
    if kind == "too_short":
        return f"is {given}, must have at least {details['ctx']['min_length']} entry"
    words = details["msg"].removeprefix("Input should be ").replace("a valid ", "a ").replace("a tuple", "a list")
    return f"is {given}, must be {words}"
