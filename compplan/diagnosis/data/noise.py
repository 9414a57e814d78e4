"""Noise: expected residuals of a perfect model, estimated from a campaign and its robot folder.

Rows of a stay scatter by the instrument; stays at the same pose scatter by the repeatability, too. With instrument
variance v and repeatability variance r, per axis, rows of one stay scatter by v, means of n rows of stays at one pose
by r + v / n, and a campaign of single rows by v + r.

Each variance has degrees of freedom, a and b; those of a sum follow Welch and Satterthwaite's formula,
(v + r)^2 / (v^2 / a + r^2 / b) [Satterthwaite1946]. The evidence contains the chi-square likelihood of the noise with
these degrees of freedom: a fit cannot attribute to noise an error that repeated measurements exclude.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, comb, gammaincinv

from compplan.diagnosis.data.shared import ENOUGH_ROWS, LEVEL, ROUNDING
from compplan.measurement.campaign import ASSUMED_SIGMA_ROTATION, FORCE_NOISE, Campaign
from compplan.measurement.pooling import LIKE_LOAD
from compplan.robot import Array
from compplan.uncertainty.assumed import REPEATABILITY

#: Default standard deviations per axis (assumed: a laser tracker at some metres). [m, rad, rad]
ASSUMED_SIGMA = {"position": 3e-5, "orientation": ASSUMED_SIGMA_ROTATION, "encoder": 5e-6}


#: Source of a noise that was estimated from visits to the same pose.
REPEATED_POSES = "scatter of poses measured again"


@dataclass(frozen=True)
class NoiseSettings:
    """Thresholds and priors of noise and outliers."""

    #: If too many rows are outlying: factor beyond the others from which a row is an outlier (assumed).
    beyond: float = 2.0
    #: Largest ratio of instrument variances of two sources that agree (assumed).
    disagree: float = 1.8
    #: Largest ratio of scatter between visits to instrument noise that counts as repeatability; a larger one is caused
    #: by backlash, drift or creep (assumed: 15 to 40 um of robots, 15 to 40 um of trackers).
    repeats_like: float = 1.5
    #: Most degrees of freedom of a noise (assumed: instruments differ by 7 % over a room).
    most_dof: float = 200.0
    #: Mean number of rows per stay up to which a stay's error is not separated from row noise (assumed).
    single_rows: float = 1.3
    #: Standard deviations beyond which a row is an outlier (theory: one row in 10^6 by chance); at most this share of
    #: the rows (assumed: 3 %).
    outlying: float = 5.5
    most: float = 0.03
    #: Degrees of freedom of a stated noise (assumed: good to a tenth), of a stated repeatability (to a sixth), and of
    #: an assumed value (to a factor of two).
    stated: float = 60.0
    stated_repeatability: float = 20.0
    assumed: float = 4.0


NOISE = NoiseSettings()


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviation of a channel per axis, and its uncertainty."""

    #: Standard deviation of a row about its stay, mean square over the rows. [m or rad]
    sigma: float
    degrees_of_freedom: float  #: Degrees of freedom of the estimate.
    source: str  #: Sources of the estimate.
    #: Standard deviation of a stay (repeatability); 0 if `sigma` of single rows includes it.
    stay: float = 0.0
    #: Standard deviation of each row over `sigma`; empty if all rows are alike. Shape (n,) or (0,).
    spread: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def chance_factor(self) -> float:
        """Factor by which the variance may exceed its estimate by chance."""
        return chance_factor(self.degrees_of_freedom)

    def spread_of(self, rows: NDArray[np.int_]) -> Array:
        """Return the standard deviation of given rows over `sigma`. Shape (rows,)."""
        return self.spread[rows] if len(self.spread) else np.ones(len(rows))


def chance_factor(freedom: float) -> float:
    """Return the factor by which a variance with these degrees of freedom may exceed another by chance."""
    least = 2.0 * gammaincinv(0.5 * freedom, 0.5 * (1.0 - LEVEL))
    return float(freedom / least) if freedom > 0 else np.inf


def estimate_noise(
    campaign: Campaign, gap: Array, stated: Array | None, name: str, repeatability: float | None = None
) -> Noise:
    """Estimate the noise of a channel.

    Args:
        campaign: The campaign.
        gap: Measured minus expected, NaN in unused rows. Shape (n, c). [m or rad]
        stated: Standard deviation that the log states row by row, or None. Shape (n,). [m or rad]
        name: Name of the channel.
        repeatability: Repeatability of the robot folder, per axis, or None. [m]
    """
    spread = _stated_spread(stated, len(campaign))
    instrument = _instrument(campaign, gap / spread[:, None], stated, name)
    variance, dof, source = instrument
    seen = np.isfinite(gap).all(1) & ~campaign.on_path
    rows_a_stay = seen.sum() / max(len(np.unique(campaign.stay[seen])), 1)
    single = bool(seen.any()) and rows_a_stay < NOISE.single_rows
    again, count, share = _revisit_scatter(campaign, gap / spread[:, None])
    plain = spread if np.ptp(spread) > ROUNDING else np.zeros(0)
    if name != "position":
        return Noise(float(np.sqrt(variance)), dof, source, 0.0, plain)
    if not dof and count:
        # repeated poses alone: they show the sum of both
        return Noise(float(np.sqrt(again)), min(count, NOISE.most_dof), REPEATED_POSES, 0.0, plain)
    variance, source = (variance, source) if dof else (ASSUMED_SIGMA[name] ** 2, "assumed")
    dof = dof or NOISE.assumed
    # the mean of pooled rows is less uncertain than a row; repeatability is compared with a row
    single_row = max(variance, campaign.scatter**2)
    # scatter of repeated poses beyond stated sigma and repeatability is drift, creep or backlash, not noise
    usual = share * variance + (repeatability or REPEATABILITY) ** 2
    odd = stated is not None and count > 0 and again > chance_factor(count) * usual
    robot, freedom, origin = _repeatability(again - share * variance, 0 if odd else count, repeatability, single_row)
    source = " and ".join(label for label in (source, origin) if label)
    if odd:
        source += (
            f"; poses measured again scatter by {np.sqrt(again / usual):.1f} times what sigma and repeatability explain"
        )
    if not single:
        return Noise(float(np.sqrt(variance)), dof, source, float(np.sqrt(robot)) if origin else 0.0, plain)
    total = spread**2 * variance + robot
    mean = float(np.mean(total))
    freedom = mean**2 / (variance**2 / dof + robot**2 / freedom)
    spread = np.sqrt(total / mean)
    return Noise(
        float(np.sqrt(mean)), min(freedom, NOISE.most_dof), source, 0.0,
        spread if np.ptp(spread) > ROUNDING else np.zeros(0),
    )  # fmt: skip


def _stated_spread(stated: Array | None, n: int) -> Array:
    """Return the stated standard deviation of each row over its root mean square. Shape (n,)."""
    if stated is None or not (np.isfinite(stated) & (stated > 0)).any():
        return np.ones(n)
    known = np.isfinite(stated) & (stated > 0)
    mean = float(np.sqrt(np.mean(stated[known] ** 2)))
    return np.where(known, np.where(known, stated, mean) / mean, 1.0)


def _instrument(campaign: Campaign, gap: Array, stated: Array | None, name: str) -> tuple[float, float, str]:
    """Pool repeats, paths and a stated sigma as far as they agree: variance, degrees of freedom, source."""
    sources: list[tuple[str, float, float]] = []
    squares, count = _repeat_scatter(campaign, gap)
    if count > 0 and squares > 0:
        sources.append(("repeats", squares / count, count))
    rough, rough_count = _path_roughness(campaign, gap)
    if rough > 0:
        sources.append(("path", rough, min(rough_count, NOISE.most_dof)))
    if stated is not None and (np.isfinite(stated) & (stated > 0)).any():
        sources.append(("sigma column", float(np.nanmean(stated[stated > 0] ** 2)), NOISE.stated))
    if not sources:
        return ASSUMED_SIGMA[name] ** 2, 0.0 if name == "position" else NOISE.assumed, "assumed"
    # vibration on a path or between repeats is not instrument noise: variances far above the least are excluded
    firm = [variance for _, variance, weight in sources if weight >= ENOUGH_ROWS] or [sources[0][1]]
    sources = [source for source in sources if source[1] < NOISE.disagree * min(firm) or source[2] < ENOUGH_ROWS]
    weight = sum(w for _, _, w in sources)
    variance = sum(v * w for _, v, w in sources) / weight
    return float(variance), float(min(weight, NOISE.most_dof)), " and ".join(label for label, _, _ in sources)


def _repeatability(
    excess: float, count: float, stated: float | None, instrument: float
) -> tuple[float, float, str]:  # fmt: skip
    """Return the variance of the robot's repeatability, its degrees of freedom, and its source ("" by default).

    `excess` is the variance between stays at one pose beyond the instrument's [m^2], `count` its degrees of freedom.
    """
    sources = []
    if stated is not None and stated > 0:
        sources.append(("stated repeatability", stated**2, NOISE.stated_repeatability))
    if count:
        scatter = min(max(excess, 0.0), NOISE.repeats_like**2 * instrument)
        # larger scatter than stated has a cause: drift or backlash
        if not sources or scatter + instrument < NOISE.disagree * (sources[0][1] + instrument):
            sources.append((REPEATED_POSES, scatter, count))
    if not sources:
        return REPEATABILITY**2, NOISE.assumed, ""
    weight = sum(w for _, _, w in sources)
    return sum(v * w for _, v, w in sources) / weight, weight, " and ".join(label for label, _, _ in sources)


def _repeat_scatter(campaign: Campaign, gap: Array) -> tuple[float, float]:
    """Return squares and degrees of freedom of rows repeated within a visit, outlying pairs left out."""
    static = ~campaign.on_path & np.isfinite(gap).all(1)
    rows = np.flatnonzero(static)
    if len(rows) < 2:
        return 0.0, 0.0
    pairs = rows[:-1][(np.diff(campaign.visit[rows]) == 0) & (np.diff(rows) == 1)]
    if not len(pairs):
        return 0.0, 0.0
    half = (gap[pairs + 1] - gap[pairs]) ** 2 / 2.0
    keep = _no_gross_pairs(half.sum(1))
    return float(half[keep].sum()), float(half[keep].size)


def _revisit_scatter(campaign: Campaign, gap: Array) -> tuple[float, float, float]:
    """Return variance between visits to one pose under one load, its degrees of freedom, and the mean of 1/rows.

    Only visits next to each other in time are compared, so that a slow drift does not count.
    """
    rows = np.flatnonzero(~campaign.on_path & np.isfinite(gap).all(1))
    if len(rows) < 2:
        return 0.0, 0.0, 1.0
    _, first, index, size = np.unique(campaign.visit[rows], return_index=True, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(index, gap[rows, k]) / size for k in range(gap.shape[1])], axis=1)
    at = rows[first]
    group = group_repeats(campaign, at)
    order = np.argsort(group, kind="stable")
    pairs = np.flatnonzero(np.diff(group[order]) == 0)
    a, b = order[pairs], order[pairs + 1]
    apart = np.abs(at[a] - at[b]) > 0
    a, b = a[apart], b[apart]
    if not len(a):
        return 0.0, 0.0, 1.0
    half = (mean[a] - mean[b]) ** 2 / 2.0
    keep = _no_gross_pairs(half.sum(1))
    share = 0.5 * float(np.mean(1.0 / size[a][keep] + 1.0 / size[b][keep]))
    return float(half[keep].mean()), float(half[keep].size), share


def group_repeats(campaign: Campaign, rows: NDArray[np.int_]) -> NDArray[np.int_]:
    """Number the poses of given rows; rows with equal pose, target and load share a number. Shape (rows,)."""
    load = np.round(campaign.wrench[rows] / max(LIKE_LOAD * campaign.load_scale, FORCE_NOISE)).astype(int)
    key = np.column_stack([campaign.pose[rows], campaign.target_index[rows], load])
    return np.asarray(np.unique(key, axis=0, return_inverse=True)[1].reshape(-1))


def _no_gross_pairs(total: Array) -> NDArray[np.bool_]:
    # limit over the median of the sum of squares of three normal numbers
    return np.asarray(total <= NOISE.outlying**2 / chdtri(3, 0.5) * max(float(np.median(total)), 1e-30))


def _path_roughness(campaign: Campaign, gap: Array) -> tuple[float, float]:
    """Return variance and degrees of freedom from third differences along paths, robustly."""
    pieces = []
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero((campaign.run_index == number) & campaign.on_path)
        values = gap[rows][np.isfinite(gap[rows]).all(1)]
        if len(values) > ENOUGH_ROWS:
            # the variance of a third difference is 1 + 9 + 9 + 1 times that of its values
            pieces.append(np.diff(values, n=3, axis=0) / np.sqrt(comb(6, 3)))
    if not pieces:
        return 0.0, 0.0
    rough = np.vstack(pieces)
    # the median of the square of a normal number
    return float(np.median(rough**2) / chdtri(1, 0.5)), rough.size / 3.0


def find_gross_outliers(campaign: Campaign, gap: Array) -> NDArray[np.int_]:
    """Find rows with a gap (n, 3) far beyond all others, before any effect is fitted."""
    length = np.linalg.norm(np.where(campaign.usable[:, None], gap, 0.0), axis=1)
    usable = length[campaign.usable]
    if len(usable) < ENOUGH_ROWS:
        return np.zeros(0, int)
    far = np.flatnonzero(length > NOISE.outlying * np.quantile(usable, LEVEL))
    return far if len(far) <= NOISE.most * len(usable) + 1 else np.zeros(0, int)


def find_outliers(campaign: Campaign, residual: Array, sigma: float, considered: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Find outliers among considered rows, shape (n,); `sigma`: scatter of the residuals of a model. [m]

    If more rows are outlying than gross errors can be, most belong to structure; only those far beyond all others are
    outliers.
    """
    length = np.where(considered & campaign.usable, np.linalg.norm(np.nan_to_num(residual), axis=1), 0.0)
    count = int(np.ceil(NOISE.most * (length > 0).sum()))
    far = np.flatnonzero(length > NOISE.outlying * sigma)
    if len(far) > count:
        limit = NOISE.beyond * np.sort(length)[-count - 1]
        far = np.flatnonzero(length > max(limit, NOISE.outlying * sigma))
    return far
