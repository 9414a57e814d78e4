"""Outliers: rows that no model of the robot explains - mistyped points, a broken beam, a target that was touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ENOUGH_ROWS, LEVEL
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

#: Rows further off than this many standard deviations are outliers (theory: one row in 10^6 by
#: chance); at most this share of the rows (assumed: the contract says 2 %).
OUTLYING, MOST = 5.5, 0.03
#: Where more rows stand out than may: only those beyond the others by this factor (assumed).
BEYOND = 2.0


def find_gross_outliers(campaign: Campaign, gap: Array) -> NDArray[np.int_]:
    """Find rows whose gap stands far out of all others, before any effect is known.

    Args:
        campaign: The campaign.
        gap: Measured minus expected positions. Shape (n, 3). [m]
    """
    length = np.linalg.norm(np.where(campaign.usable[:, None], gap, 0.0), axis=1)
    usable = length[campaign.usable]
    if len(usable) < ENOUGH_ROWS:
        return np.zeros(0, int)
    far = np.flatnonzero(length > OUTLYING * np.quantile(usable, LEVEL))
    return far if len(far) <= MOST * len(usable) + 1 else np.zeros(0, int)


def find_outliers(campaign: Campaign, residual: Array, sigma: float, considered: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Find rows that stand out of the scatter that a fitted model leaves.

    Where more rows stand out than gross errors can be, they are structure, and only those beyond all others are
    outliers.

    Args:
        campaign: The campaign.
        residual: Measured minus fitted positions. Shape (n, 3). [m]
        sigma: Standard deviation of the scatter per axis. [m]
        considered: Rows that may be outliers. Shape (n,).
    """
    length = np.where(considered & campaign.usable, np.linalg.norm(np.nan_to_num(residual), axis=1), 0.0)
    count = int(np.ceil(MOST * (length > 0).sum()))
    far = np.flatnonzero(length > OUTLYING * sigma)
    if len(far) > count:
        limit = BEYOND * np.sort(length)[-count - 1]
        far = np.flatnonzero(length > max(limit, OUTLYING * sigma))
    return far
