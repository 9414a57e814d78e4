"""Constants and ordering rules that all packages of the diagnosis share."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from compplan.robot import Array

#: Level of every interval and every test against chance (theory: the usual 95 %).
LEVEL = 0.95
#: Standard deviations of a two-sided interval at that level (theory).
HALF_WIDTH = float(ndtri(0.5 * (1.0 + LEVEL)))
#: Probability from which a claim counts as certain; its complement as excluded (assumed: one in ten).
CERTAIN = 0.9
#: Shares, probabilities and improvements below this do not matter (assumed: a fiftieth).
NEGLIGIBLE = 0.02
#: Sample size of rows, pairs or draws (assumed: estimates a tail of a twentieth to a fifth of itself).
SAMPLE = 400
#: Fewest rows or poses for a percentile, a roughness or a curve, and for a mean (assumed).
ENOUGH_ROWS, FEW_ROWS = 20, 5
#: Most lines of a list for a reader (assumed).
LISTED = 12
#: Most steps of a fit that begins near its solution (assumed: most converge in ten).
STEPS = 12
#: Relative error that halves the digits of a float; smaller differences are rounding (theory).
ROUNDING = float(np.sqrt(np.finfo(float).eps))
#: Decimals of log evidences, and digits of other numbers, for ordering candidates (theory: rounding errors of linear
#: algebra are far smaller; a difference of .001 in log evidence does not matter).
DECIMALS, DIGITS = 3, 4
#: Seed of every draw (assumed: any other would do).
SEED = 20


def rank_evidence(value: float) -> float:
    """Round a log evidence for ordering: candidates that differ by rounding errors alone keep their order."""
    return round(float(value), DECIMALS)


def rank_number(value: float) -> float:
    """Round a share or a length for ordering: candidates that differ by rounding errors alone keep their order."""
    return float(f"{value:.{DIGITS}g}")


def beats_chance(tried: int) -> float:
    """Return the log likelihood gain that the best of n tried waves exceeds by chance in one case of twenty.

    Twice the gain of two values in pure noise is chi-square of two degrees of freedom, P(gain > g) = exp(-g), so that
    the best of n exceeds g = log(n / (1 - level)) in the share 1 - level of all cases.
    """
    return float(np.log(max(tried, 1) / (1.0 - LEVEL)))


def rms_length(rows: Array) -> float:
    """Return the root mean square length of vectors, shape (n, k); 0 if there are none."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1)))) if len(rows) else 0.0
