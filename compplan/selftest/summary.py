"""Summary of a study: rates, confusion, calibration, detection against size, and answers with the truth withheld."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from compplan.selftest.scoring import Score, is_honest, score_answer

#: Bins of stated probability; answers of one bin should hold as often as they say.
BINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
#: A later campaign is predicted where its gap is at most this many noise floors, by difficulty.
AT_THE_FLOOR = {"clean": 1.1, "realistic": 1.3}
#: Bins of an effect's gap over the standard deviation of one coordinate.
SIZES = (0.0, 5.0, 8.0, 12.0, 20.0, 35.0, np.inf)


def summarise_study(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the records of a study.

    Args:
        records: What `run_study` returned.
    """
    scores = [score_answer(record["truth"], record["answer"]) for record in records]
    withheld = [(r["truth"], score_answer(r["truth"], r["withheld"])) for r in records if "withheld" in r]
    claims = [(claim.probability, claim.right) for score in scores for claim in score.claims]
    return {
        "schema": 1,
        "campaigns": len(scores),
        "kinds": [summarise_kind(scores, kind, level) for kind, level in _groups(scores)],
        "claims": {
            "count": len(claims),
            "precision": _mean(right for _, right in claims),
            "confident_wrong_share": _mean(p > 0.8 and not right for p, right in claims),
            "cases_with_confident_wrong_share": _mean(score.confident_wrong > 0 for score in scores),
        },
        "calibration": calibrate(claims),
        "ties": _ties(scores),
        "confusion": confuse(scores),
        "detection": detect(scores),
        "withheld": summarise_withheld(withheld),
        "seconds": _spread([score.seconds for score in scores]),
    }


def summarise_kind(scores: Sequence[Score], kind: str, difficulty: str) -> dict[str, Any]:
    """Return the rates of one kind and difficulty."""
    part = [s for s in scores if (s.kind, s.difficulty) == (kind, difficulty)]
    fresh = [s.fresh for s in part]
    return {
        "kind": kind,
        "difficulty": difficulty,
        "campaigns": len(part),
        "all_named": _mean(s.all_named for s in part) if any(s.known for s in part) else None,
        "nothing_false": _mean(s.false_names == 0 for s in part),
        "false_names_a_case": _mean(s.false_names for s in part),
        "status_right": _mean(s.status == s.expected for s in part),
        "unknown_or_partly": _mean(s.status in ("unknown", "partly_explained") for s in part),
        "fresh_over_floor_median": float(np.median(fresh)),
        "fresh_over_floor_p90": float(np.quantile(fresh, 0.9)),
        "nominal_over_floor_median": float(np.median([s.fresh_nominal for s in part])),
        "at_the_floor": _mean(s.fresh <= AT_THE_FLOOR.get(difficulty, 1.1) for s in part),
        "fresh_worse": sum(s.worse for s in part),
    }


def calibrate(claims: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Return the calibration curve and its expected error, and the Brier score.

    Args:
        claims: Stated probability of each claim, and whether it was right.
    """
    if not claims:
        return {"bins": [], "expected_error": None, "brier": None}
    p, right = np.array([c[0] for c in claims]), np.array([c[1] for c in claims], float)
    number = np.clip(np.searchsorted(BINS, p, side="left") - 1, 0, len(BINS) - 2)
    bins, error = [], 0.0
    for k in range(len(BINS) - 1):
        inside = number == k
        if inside.any():
            stated, held = float(p[inside].mean()), float(right[inside].mean())
            low, high = _interval(int(right[inside].sum()), int(inside.sum()))
            error += float(inside.mean()) * abs(stated - held)
            bins.append(
                {"from": BINS[k], "to": BINS[k + 1], "claims": int(inside.sum()), "stated": stated, "right": held,
                 "low": low, "high": high}
            )  # fmt: skip
    return {"bins": bins, "expected_error": error, "brier": float(np.mean((p - right) ** 2))}


def confuse(scores: Sequence[Score]) -> dict[str, Any]:
    """Return the confusion matrix: rows are what is there, columns what is named; missed effects in "(not named)"."""
    cells: Counter[tuple[str, str]] = Counter()
    for score in scores:
        for name, *_ in score.known:
            named = [claim.name for claim in score.claims if claim.truth == name]
            cells[name, named[0] if named else "(not named)"] += 1
        for claim in score.claims:
            if claim.truth == "background":
                cells["(small background)", claim.name] += 1
            elif not claim.right:
                cells["(unknown effect)" if score.unknown else "(nothing)", claim.name] += 1
    rows = sorted({row for row, _ in cells})
    columns = sorted({column for _, column in cells})
    return {"rows": rows, "columns": columns, "counts": [[cells[row, column] for column in columns] for row in rows]}


def detect(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Return how often effects are named, by the size of their gap over the standard deviation of one coordinate."""
    table = []
    for low, high in pairwise(SIZES):
        for alone in (True, False):
            found = [f for s in scores if (len(s.known) == 1) == alone for *_, size, f in s.known if low <= size < high]
            if found:
                ends = _interval(sum(found), len(found))
                table.append(
                    {"from": low, "to": None if np.isinf(high) else high, "alone": alone, "effects": len(found),
                     "named": _mean(found), "low": ends[0], "high": ends[1]}
                )  # fmt: skip
    return table


def summarise_withheld(withheld: Sequence[tuple[dict[str, Any], Score]]) -> dict[str, Any]:
    """Return what is said when the true effect is no candidate, effect by effect."""
    by_name: dict[str, list[tuple[dict[str, Any], Score]]] = {}
    for truth, score in withheld:
        by_name.setdefault(truth["effects"][0]["effect"], []).append((truth, score))
    rows = [{"effect": name, **_withheld_rates(part)} for name, part in sorted(by_name.items())]
    return {"effects": rows, "all": _withheld_rates(withheld)}


def _withheld_rates(part: Sequence[tuple[dict[str, Any], Score]]) -> dict[str, Any]:
    return {
        "campaigns": len(part),
        "honest": _mean(is_honest(score) for _, score in part),
        "unknown": _mean(score.status == "unknown" for _, score in part),
        "rival_named": _mean(any(claim.right for claim in score.claims) for _, score in part),
        "false_names_a_case": _mean(score.false_names for _, score in part),
        "confident_wrong": sum(score.confident_wrong > 0 for _, score in part),
        "predicts_later": _mean(score.fresh <= AT_THE_FLOOR.get(score.difficulty, 1.1) for _, score in part),
        "fresh_worse": sum(score.worse for _, score in part),
    }


def _ties(scores: Sequence[Score]) -> dict[str, Any]:
    ties, listed = sum(s.ties[0] for s in scores), sum(s.ties[1] for s in scores)
    rivals, idle = sum(s.rivals[0] for s in scores), sum(s.rivals[1] for s in scores)
    return {
        "ties": ties, "listed_share": listed / ties if ties else None,
        "rivals_listed": rivals, "idle_share": idle / rivals if rivals else None,
        "claims_with_idle_rivals_share": _mean(s.rivals[1] > 0 for s in scores if s.claims),
    }  # fmt: skip


def _groups(scores: Sequence[Score]) -> list[tuple[str, str]]:
    return sorted({(s.kind, s.difficulty) for s in scores})


def _mean(values: Iterable[float | bool]) -> float | None:
    numbers = [float(value) for value in values]
    return float(np.mean(numbers)) if numbers else None


def _spread(values: Sequence[float]) -> dict[str, float | None]:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return {"median": None, "p95": None, "max": None}
    return {"median": float(np.median(known)), "p95": float(np.quantile(known, 0.95)), "max": float(max(known))}


def _interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate [Wilson1927]."""
    z, p = 1.96, hits / count
    centre = (p + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2)) / (1 + z**2 / count)
    return float(max(centre - half, 0.0)), float(min(centre + half, 1.0))
