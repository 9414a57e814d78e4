"""Contents of a program in addition to its path: stops, configurations and turns, axis rates, load of the tool.

Each is computed here from the commanded joints, by the definitions in the makers' manuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.readback.poses import Move
from compplan.controllers.writers.joint_convention import JointConvention, locate_links, measure_words
from compplan.robot import Array, Robot

#: Distance to a change of turn below which either turn is accepted. [deg]
NEAR = 1e-3
#: Distance to the threshold of a configuration word below which either value is accepted. [deg or mm]
DOUBTFUL = 1e-2
#: Accepted relative and absolute error of axis rates [percent]: some languages write whole percents from 1 to 100.
RATE_SHARE, RATE_STEP = 0.05, 0.51
#: Rounding of a mass [kg] and of its centre [mm].
MASS, CENTRE = 0.01, 0.05
#: Contribution of each configuration word to cfx of a RAPID target, and the value that counts.
CFX = {"shoulder": ("back", 4), "elbow": ("down", 2), "wrist": ("flip", 1)}
#: The value that sets each of the first three numbers of RCONF (no flip, lower arm, rear).
RCONF = (("wrist", "noflip"), ("elbow", "down"), ("shoulder", "back"))
#: Order of the letters in CONFIG of a FANUC position.
LETTERS = ("wrist", "elbow", "shoulder")


@dataclass(frozen=True)
class PostureWord:
    """One configuration word at every row."""

    values: NDArray[np.str_]  #: Its value. Shape (n,).
    clear: NDArray[np.bool_]  #: Whether the row is clear of the threshold. Shape (n,).
    #: Contribution of each value to S of a KRL position, empty where not defined.
    status: Mapping[str, int] = field(default_factory=dict)
    #: Each value in the controller's language, empty where not defined.
    native: Mapping[str, str] = field(default_factory=dict)


def read_words(counting: JointConvention, robot: Robot, q: Array) -> dict[str, PostureWord]:
    """Return the configuration words of postures. Shape (n, nq). [rad or m]"""
    return {
        key: PostureWord(values, distance > DOUBTFUL, counting.words[key].status, counting.words[key].native)
        for key, (values, distance) in measure_words(counting, robot, q, locate_links(robot, q)).items()
    }


@dataclass(frozen=True)
class ReportedProgram:
    """Expected contents of programs, at their rows."""

    arm: Array  #: Joints of the arm in the controller's convention. Shape (m, 6). [deg]
    words: Mapping[str, PostureWord]  #: Configuration words by name.
    rapid: NDArray[np.bool_]  #: Whether the move to each row is rapid. Shape (m,).
    #: Whether the tool has to stop at each row, in addition to the ends of rapid moves. Shape (m,).
    exact_stops: NDArray[np.bool_]
    share: Array  #: Share of the axis rates in the move to each row, nan where unknown. Shape (m,).
    mass: float | None = None  #: Mass of the tool, None where it is not stated. [kg]
    #: Centre of the tool's mass in the pendant's flange frame. Shape (3,). [mm]
    centre: Array = field(default_factory=lambda: np.zeros(3))

    def compare(self, language: str, moves: Sequence[Move]) -> list[str]:
        """Return the differences between the moves of a program, one for each row, and the expected contents."""
        messages = [
            "" if language == "csv" else self._compare_stops(moves), self._compare_words(language, moves),
            self._compare_shares(moves), self._compare_load(moves),
        ]  # fmt: skip
        return [text for text in messages if text]

    def _compare_stops(self, moves: Sequence[Move]) -> str:
        joint = np.array([move.kind == "joint" for move in moves])
        alone = self.rapid | joint if not joint.all() else self.rapid
        planned = alone | np.r_[alone[1:], True] | self.exact_stops
        found = np.array([move.stops for move in moves])
        wrong = np.flatnonzero(found != planned)
        if not len(wrong):
            return ""
        row = int(wrong[0])
        more = f", nor at {len(wrong) - 1} others" if len(wrong) > 1 else ""
        return f"the program {'runs through' if planned[row] else 'stops at'} row {row}, the plan does not{more}"

    def _compare_words(self, language: str, moves: Sequence[Move]) -> str:
        rows = np.array([k for k, move in enumerate(moves) if move.configuration], int)
        if not len(rows):
            return ""
        found = [moves[k].configuration for k in rows.tolist()]
        for place, (name, planned, clear) in enumerate(self._list_words(language)):
            if not clear.any() or len(found[0]) <= place:
                continue
            stated = [str(words[place]) for words in found]
            for k, word in zip(rows.tolist(), stated, strict=True):
                if clear[k] and word != planned[k]:
                    return f"{name} is {word} at row {k}, the arm stands at {planned[k]}"
        return ""

    def _list_words(self, language: str) -> list[tuple[str, list[str], NDArray[np.bool_]]]:
        """Return a language's configuration words in order: name, text at every row, rows clear of the threshold."""
        arm, words = self.arm, self.words
        clear = np.ones(len(arm), bool)
        for word in words.values():
            clear = clear & word.clear
        if arm.shape[1] != 6:
            return []
        if language in ("krl", "sinumerik"):
            status = self._add_up({key: word.status for key, word in words.items()})
            stated = len(words) > 0 and all(word.status for word in words.values())
            bits = np.asarray((arm < 0.0) @ (1 << np.arange(6)), int)
            known, clear = clear & np.full(len(arm), stated), np.asarray((np.abs(arm) > NEAR).all(axis=1))
            return [("S" if language == "krl" else "STAT", _texts(status), known),
                    ("T" if language == "krl" else "TU", _texts(bits), clear)]  # fmt: skip
        if language == "fanuc_ls":
            letters = [(f"CONFIG {key}", *self._native_word(key)) for key in LETTERS]
            return letters + [(f"turns of J{k + 1}", *_count(arm[:, k] + 180.0, 360.0)) for k in (0, 3, 5)]
        if language == "rapid":
            turns = [(f"cf{k + 1}", *_count(arm[:, k], 90.0)) for k in (0, 3, 5)]
            adds = {key: {value: add} for key, (value, add) in CFX.items() if key in words}
            return [*turns, ("cfx", _texts(self._add_up(adds)), clear)]
        if language == "inform":
            if not all(key in words for key, _ in RCONF):
                return []
            first = [(f"RCONF {key}", _texts(words[key].values == value), words[key].clear) for key, value in RCONF]
            return first + [(f"RCONF turn of axis {k + 1}", _texts(arm[:, k] >= 180.0), _clear(arm[:, k] - 180.0))
                            for k in (3, 5, 0)]  # fmt: skip
        if language == "val3":
            return [(key, *self._native_word(key)) for key in ("shoulder", "elbow", "wrist")]
        return []

    def _add_up(self, adds: Mapping[str, Mapping[str, int]]) -> NDArray[np.int_]:
        total = np.zeros(len(self.arm), int)
        for key, add in adds.items():
            total += np.array([add.get(value, 0) for value in self.words[key].values.tolist()], int)
        return total

    def _native_word(self, key: str) -> tuple[list[str], NDArray[np.bool_]]:
        """Return a word in the controller's language, and rows clear of the threshold: none where it is not defined."""
        if key not in self.words or not self.words[key].native:
            return [""] * len(self.arm), np.zeros(len(self.arm), bool)
        word = self.words[key]
        return [word.native.get(value, "") for value in word.values.tolist()], word.clear

    def _compare_shares(self, moves: Sequence[Move]) -> str:
        stated = np.array([np.nan if move.percent is None else move.percent for move in moves])
        planned = np.minimum(100.0 * self.share, 100.0)
        off = np.minimum(np.abs(stated - planned), np.abs(stated - np.maximum(planned, 1.0)))
        off -= RATE_SHARE * planned + RATE_STEP
        off[self.rapid | ~np.isfinite(off)] = -1.0
        if off.max(initial=-1.0) <= 0.0:
            return ""
        row = int(off.argmax())
        return f"{stated[row]:.3g} % of the axis rates at row {row}, the plan takes {planned[row]:.3g} %"

    def _compare_load(self, moves: Sequence[Move]) -> str:
        load = moves[0].load
        if not load or self.mass is None or not self.mass > 0.0:
            return ""
        if abs(load[0] - self.mass) > MASS:
            return f"a tool of {load[0]:.4g} kg, the job's has {self.mass:.4g}"
        if len(load) >= 4 and np.abs(np.array(load[1:4]) - self.centre).max() > CENTRE:
            return "the centre of the tool's mass is not the job's"
        return ""


def _texts(values: NDArray[np.int_] | NDArray[np.bool_]) -> list[str]:
    return [str(int(value)) for value in values.tolist()]


def _clear(values: Array, step: float = np.inf) -> NDArray[np.bool_]:
    return np.asarray(np.abs(values - (0.0 if np.isinf(step) else step * np.round(values / step))) > NEAR)


def _count(values: Array, step: float) -> tuple[list[str], NDArray[np.bool_]]:
    """Return the number of full steps below each value, and whether the value is clear of the next step."""
    return _texts(np.floor(values / step).astype(int)), _clear(values, step)
