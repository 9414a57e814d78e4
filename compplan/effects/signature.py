"""The nouns of the effects: an effect with its parameters, and the signature that it leaves to first order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.robot import Array, Robot


@dataclass(frozen=True)
class Effect:
    """One thing that is wrong with a robot or an instrument, with its size.

    Attributes:
        name: Name in the vocabulary.
        joint: Joint it sits at, or None.
        axis: Axis it acts about or along, or None.
        parameters: Numbers by key; the key ends in the unit (SI).

    """

    name: str
    joint: str | None = None
    axis: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Name, joint and axis, which say which effect it is."""
        return self.name, self.joint, self.axis

    def to_table(self) -> dict[str, Any]:
        """Return the table that effects.toml holds."""
        table: dict[str, Any] = {"effect": self.name}
        if self.joint is not None:
            table["joint"] = self.joint
        if self.axis is not None:
            table["axis"] = self.axis
        return {**table, "parameters": {key: plain(value) for key, value in self.parameters.items()}}


@dataclass(frozen=True, eq=False)
class Signature:
    """What an effect at one place, in one form, adds to the measurement per unit of its parameters, to first order.

    Attributes:
        name: Name of the effect.
        joint: Its joint, or None.
        axis: Its axis, or None.
        form: Which of the effect's forms; several forms of one effect at one place exclude each other.
        keys: Key of each parameter. A key "name#3" is item 3 of the list "name". Length k.
        scale: Size that a parameter has where the effect is plain to see: the standard deviation of its prior. Shape
            (k,).
        twist: Motion of the target, base axes, per unit of each parameter. Shape (n, 6, k). [m, rad]
        encoder: Change of the link-side readings; None for none. Shape (n, nq, k). [rad or m]
        fixed: Settings that the form holds fixed, such as a row or a period.
        positive: Whether no parameter can be negative.
        least: Least value that each parameter can have; empty for no bound. Length k.
        tried: Number of alternatives (rows, periods) that this form was picked from.
        columns: Names of the parameters' columns. Signatures of one effect whose columns have the same name share them;
            empty for columns of its own.
        between: Change of the known distances between contacts; None for none. Shape (d, 1, k). [m]
    """

    name: str
    joint: str | None
    axis: str | None
    form: str
    keys: tuple[str, ...]
    scale: Array
    twist: Array
    encoder: Array | None = None
    fixed: Mapping[str, Any] = field(default_factory=dict)
    positive: bool = False
    least: tuple[float, ...] = ()
    tried: int = 1
    columns: tuple[str, ...] = ()
    between: Array | None = None

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Name, joint and axis."""
        return self.name, self.joint, self.axis

    @property
    def event(self) -> tuple[str, str | None, str | None, int | None]:
        """Its place, and the row of what happens at one: a target may move several times."""
        return *self.place, self.fixed.get("row")

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns, unique over all effects."""
        own = self.columns or tuple(f"{self.axis} {self.form} {key}" for key in self.keys)
        return tuple(f"{self.name} {self.joint} {column}" for column in own)

    def without_motion(self) -> Signature:
        """Return what it is, without what it adds to each row: that takes most of its memory."""
        return replace(self, twist=np.zeros((0, *self.twist.shape[1:])), encoder=None, between=None)

    def effect(self, values: Array) -> Effect:
        """Return the effect with these values of the parameters."""
        return Effect(self.name, self.joint, self.axis, pack_parameters(self.keys, values, self.fixed))


class EffectModel(Protocol):
    """What one file of this package offers: one effect of the vocabulary."""

    name: str
    words: str

    def signatures(self, at: Linearization) -> Iterable[Signature]:
        """List the places and forms in which the campaign could show the effect, with their signatures."""
        ...

    def apply(self, scene: ForwardModel, effect: Effect) -> ForwardModel:
        """Put the effect into a scene, exactly."""
        ...

    def fold(self, robot: Robot, effect: Effect) -> Robot | None:
        """Write the effect into URDF and springs; None where they cannot say it (it then stands in effects.toml)."""
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
