"""Scores of answers against labelled truths, class by class, every share with its 95 % interval [Wilson1927]."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

#: A claim stated at least so surely that is wrong is a confident wrong name.
CONFIDENT = 0.8
#: A small everyday error whose gap is at least so many standard deviations of a coordinate may be named.
REAL = 1.0
#: A rival whose fit differs by at most so many standard deviations in all is a tie; without a distance, its R2.
TIE_DISTANCE, TIE_R2 = 2.0, 0.98
#: The updated robot predicts worse than the nominal one where its rms is larger by more than this factor.
WORSE = 1.002
#: Kinds that mean a known effect beside an unknown one.
BESIDE = ("mixed", "partly")

Table = Mapping[str, Any]


@dataclass(frozen=True)
class Claim:
    """One claim: right if a true effect, what the campaign cannot tell from it, or a real small error is named."""

    label: str
    probability: float
    right: bool
    small: bool


@dataclass(frozen=True)
class Score:
    """One answer against the truth."""

    case: str  #: Name of the case.
    kind: str  #: single, double, triple, quadruple, mixed, unknown, background, none ...
    status: str  #: Status of the verdict; "refused" where there was none.
    placed: tuple[bool, ...]  #: For each required known effect, whether it is named at its place.
    missed: tuple[str, ...]  #: Labels of required effects that are not.
    claims: tuple[Claim, ...]  #: The claims.
    #: For each right claim whose truth has an indistinguishable rival, whether a rival of it is listed.
    ties: tuple[bool, ...]
    fresh: float  #: Rms of the later campaign with the updated robot. [mm]
    nominal: float  #: The same with the nominal robot. [mm]
    stated: float  #: Held-out rms that the answer states. [mm]
    floor: float  #: Noise floor of the truth. [mm]
    seconds: float  #: CPU time of the diagnosis.

    @property
    def clean(self) -> bool:
        """Tell whether nothing false is named."""
        return all(claim.right for claim in self.claims)

    @property
    def complete(self) -> bool:
        """Tell whether every required effect is named."""
        return all(self.placed)


def label_of(effect: Table) -> str:
    """Write an effect and its place in a few words."""
    return " ".join(str(effect[key]) for key in ("effect", "joint", "axis") if effect.get(key))


def is_known(effect: Table) -> bool:
    """Tell whether an effect stands in the vocabulary."""
    return bool(effect.get("in_vocabulary", True)) and effect["effect"] != "unknown"


def same_place(claim: Table, truth: Table) -> bool:
    """Tell whether two name the same effect and place; a place without axis covers its axes."""
    if claim["effect"] != truth["effect"] or claim.get("joint") != truth.get("joint"):
        return False
    return truth.get("axis") is None or claim.get("axis") is None or claim["axis"] == truth["axis"]


def names(claim: Table, truth: Table) -> bool:
    """Tell whether a claim names an effect, or one that the truth accepts for it."""
    return same_place(claim, truth) or any(same_place(claim, other) for other in truth.get("acceptable", []))


def size_of(small: Table, sigma: float | None) -> float:
    """Return the gap of a small error over the standard deviation of one coordinate."""
    for key in ("seen_sigma", "over_sigma"):
        if small.get(key) is not None:
            return float(small[key])
    return float(small.get("gap_rms_mm") or 0.0) / sigma if sigma else 0.0


def score_answer(case: str, truth: Table, answer: Table) -> Score:
    """Compare an answer with the truth.

    Args:
        case: Its name.
        truth: What truth.json holds.
        answer: What a contestant said.
    """
    said = answer["verdict"]["effects"]
    known = [e for e in truth["effects"] if is_known(e)]
    required = [e for e in known if e.get("required", True)]
    small = list_small(truth)
    placed = tuple(any(names(c, e) for c in said) for e in required)
    gone = truth.get("split", {}).get("fresh", {}).get("outlier_rows", [])
    return Score(
        case=case,
        kind=str(truth["kind"]),
        status=answer["verdict"]["status"],
        placed=placed,
        missed=tuple(label_of(e) for e, found in zip(required, placed, strict=True) if not found),
        claims=tuple(judge(c, known, small) for c in said),
        ties=tuple(_ties(said, known)),
        fresh=rms_of(answer.get("fresh_updated", []), gone),
        nominal=rms_of(answer.get("fresh_nominal", []), gone),
        stated=float(answer.get("gap", {}).get("held_out_after_rms_mm") or np.nan),
        floor=float(truth.get("noise_floor_rms_mm") or np.nan),
        seconds=float(answer.get("seconds") or np.nan),
    )


def list_small(truth: Table) -> list[Table]:
    """List the small errors of a truth that may be named."""
    return [b for b in truth.get("background", []) if size_of(b, truth.get("sigma_mm")) >= REAL]


def judge(claim: Table, known: Sequence[Table], small: Sequence[Table]) -> Claim:
    """Find what stands behind a claim."""
    true = any(names(claim, e) for e in known)
    beside = not true and any(same_place(claim, b) for b in small)
    return Claim(label_of(claim), float(claim["probability"]), true or beside, beside)


def _ties(said: Sequence[Table], known: Sequence[Table]) -> Iterable[bool]:
    for effect in known:
        twins = [
            a for a in effect.get("acceptable", [])
            if (a["distance"] <= TIE_DISTANCE if a.get("distance") is not None else a.get("r2", 0.0) >= TIE_R2)
        ]  # fmt: skip
        family = [effect, *twins]
        for claim in said if twins else []:
            if any(same_place(claim, member) for member in family):
                others = [m for m in family if not same_place(claim, m)]
                yield any(same_place(rival, m) for rival in claim.get("ambiguous_with", []) for m in others)
                break


def rms_of(values: Sequence[float | None], without: Sequence[int]) -> float:
    """Return the rms of distances, missing ones and gross outliers left out."""
    kept = [v for k, v in enumerate(values) if v is not None and k not in set(without)]
    return float(np.sqrt(np.mean(np.square(kept)))) if kept else float("nan")


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share [Wilson1927]."""
    if not count:
        return 0.0, 1.0
    z, p = 1.96, hits / count
    centre = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))


def share(flags: Iterable[bool]) -> dict[str, Any]:
    """Return hits, count, share and its interval."""
    values = [bool(f) for f in flags]
    low, high = wilson(sum(values), len(values))
    value = sum(values) / len(values) if values else None
    return {"hits": sum(values), "count": len(values), "share": value, "low": low, "high": high}


def calibration_error(claims: Sequence[Claim], bins: int = 10) -> float | None:
    """Return the expected calibration error over bins of equal width [Guo2017]."""
    if not claims:
        return None
    p, right = np.array([c.probability for c in claims]), np.array([c.right for c in claims], float)
    at = np.minimum((p * bins).astype(int), bins - 1)
    return float(sum((at == k).mean() * abs(p[at == k].mean() - right[at == k].mean()) for k in set(at.tolist())))


def calibration_bins(claims: Sequence[Claim], bins: int = 10) -> list[dict[str, Any]]:
    """Return stated and true share of the claims of each bin."""
    at = [min(int(c.probability * bins), bins - 1) for c in claims]
    return [
        {"stated": float(np.mean([c.probability for c, b in zip(claims, at, strict=True) if b == k])),
         **share(c.right for c, b in zip(claims, at, strict=True) if b == k)}
        for k in sorted(set(at))
    ]  # fmt: skip


def summarise(scores: Sequence[Score]) -> dict[str, Any]:
    """Summarise the answers of one contestant in the classes that the project promises.

    Args:
        scores: One a case.

    Returns:
        Shares by name (hits, count, share, low, high), and figures: calibration, stated over true error, CPU time.
    """
    claims = [c for s in scores for c in s.claims]
    sure = [c for c in claims if c.probability >= CONFIDENT]
    judged = [s for s in scores if np.isfinite(s.fresh) and np.isfinite(s.nominal)]
    ratios = np.array([s.stated / s.fresh for s in judged if np.isfinite(s.stated) and s.fresh > 0.0])
    shares = {name: share(flags(scores)) for name, flags in CLASSES.items()}
    shares |= {
        "precision of claims": share(c.right for c in claims),
        "wrong among claims stated .8 and more": share(not c.right for c in sure),
        "ties honest": share(t for s in scores for t in s.ties),
        "later campaign predicted worse than by the nominal robot": share(s.fresh > WORSE * s.nominal for s in judged),
        "stated error below .8 of the true one": share((ratios < 0.8).tolist()),
        "no answer": share(s.status == "refused" for s in scores),
    }
    return {
        "cases": len(scores),
        "shares": shares,
        "calibration_error": calibration_error(claims),
        "calibration": calibration_bins(claims),
        "stated_over_true_median": float(np.median(ratios)) if len(ratios) else None,
        "stated_off_median": float(np.median(np.abs(ratios - 1.0))) if len(ratios) else None,
        "fresh_over_floor_median": _median([s.fresh / s.floor for s in judged]),
        "nominal_over_floor_median": _median([s.nominal / s.floor for s in judged]),
        "false_names_per_unknown": _mean(
            [len([c for c in s.claims if not c.right]) for s in scores if s.kind == "unknown"]
        ),
        "seconds_median": _median([s.seconds for s in scores]),
    }


def _median(values: Sequence[float]) -> float | None:
    good = [v for v in values if np.isfinite(v)]
    return float(np.median(good)) if good else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _of(*kinds: str) -> Callable[[Sequence[Score]], list[Score]]:
    return lambda scores: [s for s in scores if s.kind in kinds and (s.placed or kinds[0] in ("unknown", "none"))]


_SINGLE, _DOUBLE, _MANY = _of("single", "indistinguishable"), _of("double"), _of("triple", "quadruple")
_BESIDE, _UNKNOWN, _NOTHING = _of(*BESIDE), _of("unknown"), _of("none", "background")
#: Classes of answers, in the words of the page: which cases, and what counts as a hit.
CLASSES: dict[str, Callable[[Sequence[Score]], Iterable[bool]]] = {
    "singles placed": lambda scores: (s.complete for s in _SINGLE(scores)),
    "singles placed, nothing false beside": lambda scores: (s.complete and s.clean for s in _SINGLE(scores)),
    "singles: nothing false": lambda scores: (s.clean for s in _SINGLE(scores)),
    "doubles complete": lambda scores: (s.complete for s in _DOUBLE(scores)),
    "doubles complete, nothing false": lambda scores: (s.complete and s.clean for s in _DOUBLE(scores)),
    "effects of triples and quadruples placed": lambda scores: (p for s in _MANY(scores) for p in s.placed),
    "known beside unknown placed": lambda scores: (p for s in _BESIDE(scores) for p in s.placed),
    "unknown called so": lambda scores: (s.status == "unknown" for s in _UNKNOWN(scores)),
    "unknown called so or partly": lambda scores: (
        s.status in ("unknown", "partly_explained") for s in _UNKNOWN(scores)
    ),
    "unknown: nothing false": lambda scores: (s.clean for s in _UNKNOWN(scores)),
    "nothing there or everyday errors: no false name": lambda scores: (s.clean for s in _NOTHING(scores)),
}
