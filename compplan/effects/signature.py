"""Effects with their parameters, and their signatures to first order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from compplan.effects.linearization import Linearization
from compplan.robot import Array


@dataclass(frozen=True)
class Effect:
    """An error of a robot or an instrument, with its parameters."""

    name: str  #: Name in the vocabulary.
    joint: str | None = None  #: Joint, or None.
    axis: str | None = None  #: Axis, or None.
    parameters: Mapping[str, Any] = field(default_factory=dict)  #: Numbers by key; the key ends in the unit (SI).

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Where the effect acts: its name, its joint and its axis, None where it has none."""
        return self.name, self.joint, self.axis

    def to_table(self) -> dict[str, Any]:
        """Return the entry of effects.toml."""
        table: dict[str, Any] = {"effect": self.name}
        if self.joint is not None:
            table["joint"] = self.joint
        if self.axis is not None:
            table["axis"] = self.axis
        return {**table, "parameters": {key: plain(value) for key, value in self.parameters.items()}}


@dataclass(frozen=True, eq=False)
class Signature:
    """Change of the measurement per unit of the parameters of an effect at one place, to first order."""

    name: str  #: Name of the effect.
    joint: str | None  #: Its joint, or None.
    axis: str | None  #: Its axis, or None.
    form: str  #: Form of the effect; forms at one place exclude each other.
    keys: tuple[str, ...]  #: Key of each parameter. A key "name#3" is item 3 of the list "name". Length k.
    scale: Array  #: Standard deviation of the prior of each parameter. Shape (k,).
    twist: Array  #: Motion of the target, base axes, per unit of each parameter. Shape (n, 6, k). [m, rad]
    encoder: Array | None = None  #: Change of the link-side readings; None for none. Shape (n, nq, k). [rad or m]
    fixed: Mapping[str, Any] = field(default_factory=dict)  #: Fixed settings of the form, such as a row or a period.
    positive: bool = False  #: Whether no parameter can be negative.
    least: tuple[float, ...] = ()  #: Lower bound of each parameter; empty for none. Length k.
    tried: int = 1  #: Number of alternatives (rows, periods) compared for this form.
    #: Names of the parameters' columns, which signatures of one effect may share; empty for separate columns.
    columns: tuple[str, ...] = ()
    between: Array | None = None  #: Change of the known distances between contacts; None for none. Shape (d, 1, k). [m]

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Where the effect acts: its name, its joint and its axis, None where it has none."""
        return self.name, self.joint, self.axis

    @property
    def event(self) -> tuple[str, str | None, str | None, int | None]:
        """Its place and, for events, its row."""
        return *self.place, self.fixed.get("row")

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns, unique over all effects."""
        own = self.columns or tuple(f"{self.axis} {self.form} {key}" for key in self.keys)
        return tuple(f"{self.name} {self.joint} {column}" for column in own)

    def part(self, form: str, keys: slice) -> Signature:
        """Return a form of the effect with some of its parameters."""
        encoder = None if self.encoder is None else self.encoder[:, :, keys]
        return replace(
            self, form=form, keys=self.keys[keys], scale=self.scale[keys], twist=self.twist[:, :, keys],
            encoder=encoder, columns=self.columns[keys], least=self.least[keys],
        )  # fmt: skip

    def without_motion(self) -> Signature:
        """Return it without `twist` and `encoder`, which take most of the memory."""
        return replace(self, twist=np.zeros((0, *self.twist.shape[1:])), encoder=None, between=None)

    def effect(self, values: Array) -> Effect:
        """Return the effect with these values of the parameters."""
        return Effect(self.name, self.joint, self.axis, pack_parameters(self.keys, values, self.fixed))


class EffectModel(Protocol):
    """Interface of the module of an effect; `apply` and `fold` (`compplan.effects`) are optional."""

    name: str
    words: str

    def signatures(self, at: Linearization) -> Iterable[Signature]:
        """List the signatures of the possible places and forms in a campaign."""
        ...


def pack_parameters(keys: Iterable[str], values: Array, fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Collect parameters under their keys; items "name#i" become a list."""
    result: dict[str, Any] = dict(fixed)
    for key, value in zip(keys, values, strict=True):
        name, hash_, _ = key.partition("#")
        if hash_:
            result.setdefault(name, []).append(float(value))
        else:
            result[name] = float(value)
    return result


def plain(value: Any) -> Any:
    """Return numbers and arrays as plain Python values."""
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.bool_ | bool):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    return float(value) if isinstance(value, np.floating) else value
