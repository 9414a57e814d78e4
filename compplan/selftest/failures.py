"""Wrong answers of a study, in words: what was there, what was said."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from compplan.selftest.scoring import HONEST, Score, is_honest, label_effect, score_answer


def list_failures(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Describe every answer that is wrong in some way, kind of failure first, one line each.

    Args:
        records: What `run_study` returned.
    """
    lines: list[str] = []
    for record in records:
        score = score_answer(record["truth"], record["answer"])
        lines += [_line(kind, record, "answer") for kind in name_failures(score)]
        if "withheld" in record:
            score = score_answer(record["truth"], record["withheld"])
            lines += [_line(kind, record, "withheld") for kind in _withheld_failures(score)]
    return sorted(lines)


def name_failures(score: Score) -> Iterator[str]:
    """Name what is wrong with an answer."""
    if not score.all_named:
        yield "missed"
    if score.confident_wrong:
        yield "confident wrong name"
    elif score.false_names:
        yield "false name"
    if score.unknown and score.status not in HONEST:
        yield "unknown not recognised"
    if score.expected == "none" and score.status != "none":
        yield "false alarm"
    if score.expected == "explained" and score.status != "explained" and score.all_named:
        yield "status"
    if score.worse:
        yield "later campaign worse"


def _withheld_failures(score: Score) -> Iterator[str]:
    if not is_honest(score):
        yield "withheld: not honest"
    if score.confident_wrong:
        yield "withheld: confident wrong name"
    if score.worse:
        yield "withheld: later campaign worse"


def _line(kind: str, record: Mapping[str, Any], which: str) -> str:
    truth, answer = record["truth"], record[which]
    score = score_answer(truth, answer)
    there = "; ".join(
        f"{label_effect(e)} (gap {e.get('gap_over_sigma', 0.0):.1f} sigma, alike: "
        f"{', '.join(label_effect(a) for a in e.get('acceptable', [])) or 'nothing'})"
        for e in truth["effects"]
    )
    said = "; ".join(
        f"{'' if claim.right else 'WRONG '}{claim.label} {claim.probability:.2f}" for claim in score.claims
    )
    hard = ", ".join(truth.get("handicaps", []))
    return (
        f"{kind} | {truth['case']} {truth.get('robot', '')}{' (' + hard + ')' if hard else ''} | there: "
        f"{there or 'nothing'} | said: {score.status}: {said or 'nothing'} | later gap over floor {score.fresh:.2f}, "
        f"nominal {score.fresh_nominal:.2f}"
    )
