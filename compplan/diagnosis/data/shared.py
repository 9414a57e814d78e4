"""Agreed: numbers that mean the same wherever the diagnosis asks for them."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from compplan.robot import Array

#: Every interval and every test against chance is at this level (theory: the usual 95 %).
LEVEL = 0.95
#: Standard deviations of a two-sided interval at that level (theory).
HALF_WIDTH = float(ndtri(0.5 * (1.0 + LEVEL)))
#: What is as probable as this is not questioned, what is as improbable as the rest not named (assumed: one in ten).
SURE = 0.9
#: Shares, probabilities and improvements below this are not worth a word or a change (assumed: a fiftieth).
NEGLIGIBLE = 0.02
#: A sample of so many tells as much as all: rows, pairs, draws (assumed: a tail of a twentieth to a fifth of itself).
SAMPLE = 400
#: Rows or poses from which a percentile, a roughness or a curve tells anything, and from which a mean does (assumed).
ENOUGH_ROWS, FEW_ROWS = 20, 5
#: Lines of a list that somebody reads, at most (assumed).
LISTED = 12
#: Steps of a fit that begins near, at most (assumed: most settle in ten).
STEPS = 12
#: Relative error that halves the digits of a float: what is smaller is rounding (theory).
ROUNDING = float(np.sqrt(np.finfo(float).eps))
#: Decimals of log evidences, and digits of other numbers, by which candidates are ordered (theory: rounding errors of
#: linear algebra lie far below; a difference of .001 in log evidence is no difference).
DECIMALS, DIGITS = 3, 4
#: Seed of every draw (assumed: any other would do).
SEED = 20


def rank_evidence(value: float) -> float:
    """Return a log evidence to be ordered by: candidates that differ in rounding errors alone keep their order."""
    return round(float(value), DECIMALS)


def rank_number(value: float) -> float:
    """Return a share or a length to be ordered by: candidates that differ in rounding errors alone keep their order."""
    return float(f"{value:.{DIGITS}g}")


def beats_chance(tried: int) -> float:
    """Return the log likelihood that the best of so many waves has by chance in one case of twenty.

    Twice the gain of two values in pure noise is chi-square of two degrees of freedom, P(gain > g) = exp(-g), so that
    the best of n is beyond g = log(n / (1 - level)) in the share 1 - level of all cases.
    """
    return float(np.log(max(tried, 1) / (1.0 - LEVEL)))


def rms_length(rows: Array) -> float:
    """Return the root mean square length of vectors, shape (n, k); 0 of none."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1)))) if len(rows) else 0.0
