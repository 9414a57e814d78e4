"""Scores of answers: what was named rightly, what falsely, what was listed as a tie, and whether the gap shrank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

#: A claim above this probability that is wrong is a confident wrong name.
CONFIDENT = 0.8
#: Statuses that say that something is not explained.
HONEST = ("unknown", "partly_explained")
#: The updated robot predicts worse than the nominal one where its rms is larger by more than this share.
WORSE = 1.002

Table = Mapping[str, Any]


@dataclass(frozen=True)
class Judged:
    """One claim, judged.

    Attributes:
        name: Effect that is claimed.
        label: Effect and place.
        probability: Probability that was stated.
        right: Whether a true effect, one that the campaign cannot tell from it, or a background error is named.
        truth: Name of the true effect that it stands for, "background", or "" for none.
    """

    name: str
    label: str
    probability: float
    right: bool
    truth: str


@dataclass(frozen=True)
class Score:
    """One answer against the truth.

    Attributes:
        kind: Kind of the case.
        difficulty: Its difficulty.
        robot: Name of its robot.
        status: Status of the verdict.
        expected: Status that the truth expects.
        known: Effects of the vocabulary that are present: name, label, gap over sigma, whether found.
        claims: The claims.
        unknown: Whether an effect outside the vocabulary is present.
        ties: Effects named that the campaign cannot tell from others, and for how many a tie was listed.
        rivals: Rivals listed, and how many of them are idle: they could not have made the gap.
        fresh: Rms of the later campaign with the updated robot over the noise floor.
        fresh_nominal: The same with the nominal robot.
        seconds: Time that the diagnosis took.
    """

    kind: str
    difficulty: str
    robot: str
    status: str
    expected: str
    known: tuple[tuple[str, str, float, bool], ...]
    claims: tuple[Judged, ...]
    unknown: bool
    ties: tuple[int, int]
    rivals: tuple[int, int]
    fresh: float
    fresh_nominal: float
    seconds: float

    @property
    def false_names(self) -> int:
        """Count claims that nothing real stands behind."""
        return sum(not claim.right for claim in self.claims)

    @property
    def all_named(self) -> bool:
        """Tell whether every effect of the vocabulary that is present was named."""
        return all(found for *_, found in self.known)

    @property
    def confident_wrong(self) -> int:
        """Count false names that were stated with confidence."""
        return sum(not claim.right and claim.probability > CONFIDENT for claim in self.claims)

    @property
    def worse(self) -> bool:
        """Tell whether the updated robot predicts the later campaign worse than the nominal one."""
        return self.fresh > WORSE * self.fresh_nominal


def label_effect(effect: Table) -> str:
    """Write an effect and its place in a few words."""
    return " ".join(str(effect[key]) for key in ("effect", "joint", "axis") if effect.get(key))


def names_same(claim: Table, truth: Table) -> bool:
    """Tell whether a claim names an effect and its place; a place without axis covers its axes."""
    if claim["effect"] != truth["effect"] or claim["joint"] != truth["joint"]:
        return False
    return truth.get("axis") is None or claim["axis"] is None or claim["axis"] == truth["axis"]


def names_alike(claim: Table, truth: Table) -> bool:
    """Tell whether a claim names an effect, or one that the campaign cannot tell from it."""
    return names_same(claim, truth) or any(names_same(claim, other) for other in truth.get("acceptable", []))


def score_answer(truth: Table, answer: Table) -> Score:
    """Compare an answer with the truth.

    Args:
        truth: What truth.json holds.
        answer: What diagnosis.json holds, with `fresh_updated` and `fresh_nominal` (distances of the later campaign's
            rows, mm) and `seconds`.
    """
    claims = answer["verdict"]["effects"]
    known = [effect for effect in truth["effects"] if effect.get("in_vocabulary", True)]
    judged = tuple(judge_claim(claim, known, truth.get("background", [])) for claim in claims)
    found = tuple(
        (e["effect"], label_effect(e), float(e.get("gap_over_sigma", 0.0)), any(names_alike(c, e) for c in claims))
        for e in known
    )
    keep = kept_rows(len(answer["fresh_updated"]), truth["split"]["fresh"].get("outlier_rows", []))
    floor = truth["noise_floor_rms_mm"]
    return Score(
        kind=truth["kind"],
        difficulty=truth.get("difficulty", ""),
        robot=truth.get("robot", ""),
        status=answer["verdict"]["status"],
        expected=truth["expected_status"],
        known=found,
        claims=judged,
        unknown=any(not effect.get("in_vocabulary", True) for effect in truth["effects"]),
        ties=count_ties(claims, known),
        rivals=count_rivals(claims, known),
        fresh=rms_of(answer["fresh_updated"], keep) / floor,
        fresh_nominal=rms_of(answer["fresh_nominal"], keep) / floor,
        seconds=float(answer.get("seconds", np.nan)),
    )


def judge_claim(claim: Table, known: Sequence[Table], background: Sequence[Table]) -> Judged:
    """Find what stands behind a claim: a true effect, the background, or nothing."""
    behind = next((e["effect"] for e in known if names_same(claim, e)), "")
    behind = behind or next((e["effect"] for e in known if names_alike(claim, e)), "")
    if not behind and any(names_same(claim, small) for small in background):
        behind = "background"
    return Judged(claim["effect"], label_effect(claim), float(claim["probability"]), bool(behind), behind)


def count_ties(claims: Sequence[Table], known: Sequence[Table]) -> tuple[int, int]:
    """Count claims that other places explain as well, and those of them that list at least one of these."""
    ties = listed = 0
    for effect in known:
        family = [effect, *effect.get("acceptable", [])]
        for claim in (c for c in claims if names_alike(c, effect)):
            if any(other["effect"] != claim["effect"] or other["joint"] != claim["joint"] for other in family):
                ties += 1
                listed += any(names_alike(rival, effect) for rival in claim["ambiguous_with"])
    return ties, listed


def count_rivals(claims: Sequence[Table], known: Sequence[Table]) -> tuple[int, int]:
    """Count listed rivals of right claims, and those among them that could not have made the gap."""
    rivals = idle = 0
    for effect in known:
        for claim in (c for c in claims if names_alike(c, effect)):
            rivals += len(claim["ambiguous_with"])
            idle += sum(not names_alike(rival, effect) for rival in claim["ambiguous_with"])
    return rivals, idle


def kept_rows(rows: int, outliers: Sequence[int]) -> np.ndarray:
    """Return the rows that are no gross outliers."""
    return np.setdiff1d(np.arange(rows), np.asarray(outliers, int))


def rms_of(distances: Sequence[float | None], keep: np.ndarray) -> float:
    """Return the rms of distances over some rows, missing ones left out."""
    values = np.array([np.nan if d is None else d for d in distances])[keep]
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def is_honest(score: Score) -> bool:
    """Tell whether an answer whose true effect was withheld is honest: unknown, or what could have made the gap."""
    return score.status in HONEST or (bool(score.claims) and score.false_names == 0)
