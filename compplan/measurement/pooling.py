"""Pooling of repeated rows: the rows of one pose are replaced by their mean and its standard deviation.

For a static model, n rows of one pose are equivalent to their mean with variance v / n; v is estimated from their
scatter. Rows belong to one pose if joints, load, target and approach direction are equal. The log is divided into
stretches. If the means of a pose differ significantly between stretches, rows are pooled within each stretch, so that
drift remains visible; otherwise each pose becomes one row, since the model error is the same at every visit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import fdtri

from compplan.measurement.campaign import FORCE_NOISE, Campaign, number_rows
from compplan.robot import Array

#: Number of rows above which a log is pooled, approximate number of means, greatest number of stretches (assumed: up to
#: 5000 rows take a minute; twenty stretches resolve drift).
FROM_ROWS, ABOUT, STRETCHES = 5000, 400, 20
#: Significance level of the scatter between stretches (theory: the usual 5 %).
CHANCE = 0.05
#: Load resolution of a pose relative to the largest load (assumed). [-]
LIKE_LOAD = 0.05
#: Greatest distance from the median of a pose, in multiples of the median distance (assumed: six standard deviations).
GROSS = 4.0
#: Greatest ratio of means to rows; above it rows are thinned instead (assumed).
FEWER = 0.5
#: Distances below this are rounding. [m]
ROUNDING = 1e-9


def pool_rows(campaign: Campaign) -> Campaign:
    """Return a campaign with pooled rows if a log has more than `FROM_ROWS`, with a note.

    Short logs, logs of paths and logs of other instruments are unchanged; a log of mostly distinct poses is thinned.
    """
    rows = np.flatnonzero(campaign.usable)
    if len(rows) <= FROM_ROWS or campaign.on_path.any() or campaign.observations is not None:
        return campaign
    single = rows[find_copies(campaign, rows)]
    group = number_poses(campaign, single)
    notes = []
    if len(single) < len(rows):
        notes.append(f"{len(rows) - len(single)} of {len(rows)} rows are exact copies of others and count once")
    if int(group.max()) + 1 > FEWER * len(single):
        part = single[:: -(-len(single) // FROM_ROWS)]
        notes.append(f"{len(single)} rows, hardly a pose met again: every {-(-len(single) // FROM_ROWS)}th is used")
        return replace(campaign.take(part), notes=(*campaign.notes, *notes))
    kept = find_inliers(campaign.position[single], group)
    whole = number_poses(campaign, single, most=1)
    if not scatter_beyond_chance(campaign.position[single][kept], group[kept], whole[kept]):
        group = whole
    group = np.unique(group[kept], return_inverse=True)[1].reshape(-1)
    count = np.bincount(group)
    poses = len(np.unique(campaign.pose[single]))
    notes.append(
        f"{len(single)} rows of {poses} poses are pooled: {len(count)} means of about {np.median(count):.0f} rows"
    )
    if (~kept).any():
        notes.append(f"{int((~kept).sum())} rows far from the others of their pose are left out")
    pooled = _average(campaign, single[kept], group)
    return replace(pooled, notes=(*campaign.notes, *notes))


def find_copies(campaign: Campaign, rows: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return indices into `rows` of those with distinct joints, load, position and target. Shape (k,), ascending."""
    parts = [campaign.q, campaign.wrench, campaign.position, campaign.target_index[:, None].astype(float)]
    _, first = np.unique(number_rows(np.concatenate(parts, axis=1)[rows]), return_index=True)
    return np.asarray(np.sort(first))


def scatter_beyond_chance(position: Array, group: NDArray[np.int_], pose: NDArray[np.int_]) -> bool:
    """Test whether the means of the groups of a pose differ significantly, given the scatter within groups (F test).

    position: (n, 3) [m]; group: part of a pose, and pose of each row, (n,).
    """
    group, pose = (np.unique(label, return_inverse=True)[1].reshape(-1) for label in (group, pose))
    of_group, of_pose = (_mean(position, label, np.bincount(label).astype(float))[label] for label in (group, pose))
    groups, poses = int(group.max()) + 1, int(pose.max()) + 1
    between, within = 3 * (groups - poses), 3 * (len(group) - groups)
    if not between or not within:
        return bool(between)
    ratio = np.sum((of_group - of_pose) ** 2) / between / max(np.sum((position - of_group) ** 2) / within, 1e-300)
    return bool(ratio > fdtri(between, within, 1.0 - CHANCE))


def number_poses(campaign: Campaign, rows: NDArray[np.int_], most: int = STRETCHES) -> NDArray[np.int_]:
    """Number the poses of rows as they appear; at most `most` stretches have numbers of their own. Shape (rows,)."""
    load = np.round(campaign.wrench[rows] / max(LIKE_LOAD * campaign.load_scale, FORCE_NOISE))
    labels = [campaign.run] if campaign.mode is None else [campaign.run, campaign.mode]
    of_labels = [np.unique(label[rows], return_inverse=True)[1].reshape(-1) for label in labels]
    pose = number_rows(
        np.column_stack([*of_labels, campaign.pose[rows], campaign.target_index[rows], load, campaign.approach[rows]])
    )
    stretches = int(np.clip(ABOUT // (int(pose.max()) + 1), 1, most))
    stretch = np.arange(len(rows)) * stretches // len(rows)
    # consecutive rows of a pose are in one stretch
    stay = campaign.stay[rows]
    begins = np.r_[True, np.diff(stay) > 0]
    stretch = stretch[np.maximum.accumulate(np.where(begins, np.arange(len(rows)), 0))]
    both = pose + (int(pose.max()) + 1) * stretch
    _, first, group = np.unique(both, return_index=True, return_inverse=True)
    rank = np.empty(len(first), int)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[group.reshape(-1)])


def find_inliers(position: Array, group: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Return which rows are not outliers of their pose. Shape (n,)."""
    order = np.argsort(group, kind="stable")
    kept = np.ones(len(group), bool)
    for part in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        distance = np.linalg.norm(position[part] - np.median(position[part], axis=0), axis=1)
        kept[part] = distance <= GROSS * max(float(np.median(distance)), ROUNDING)
    return kept


def _average(campaign: Campaign, rows: NDArray[np.int_], group: NDArray[np.int_]) -> Campaign:
    """Average rows by group."""
    count = np.bincount(group).astype(float)
    order = np.argsort(group, kind="stable")
    first = rows[order[np.r_[True, np.diff(group[order]) > 0]]]
    found: dict[str, Any] = {}
    for name in ("q", "wrench", "position", "time", "temperature", "link", "motor"):
        values = getattr(campaign, name)
        found[name] = None if values is None else _mean(values[rows], group, count)
    found["moved"] = _mean(campaign.last_move[rows], group, count)
    found["sigma"] = _sigma(campaign.position[rows], _part(campaign.sigma, rows), group, count)
    if campaign.rotation is not None:
        turns = _mean(campaign.rotation[rows].reshape(-1, 9), group, count).reshape(-1, 3, 3)
        known = np.asarray(np.isfinite(turns).reshape(-1, 9).all(axis=1), bool)
        turns[known] = Rotation.from_matrix(turns[known]).as_matrix()
        off = np.full((len(rows), 3), np.nan)
        measured = np.asarray(np.isfinite(campaign.rotation[rows]).reshape(-1, 9).all(axis=1), bool)
        seen = known[group] & measured
        product = campaign.rotation[rows][seen] @ np.swapaxes(turns[group[seen]], 1, 2)
        off[seen] = Rotation.from_matrix(product).as_rotvec()
        found["rotation"] = turns
        found["sigma_rotation"] = _sigma(off, _part(campaign.sigma_rotation, rows), group, count)
    if found["sigma"] is not None:
        found["scatter"] = float(np.sqrt(np.mean(found["sigma"] ** 2 * count)))
    return replace(campaign.take(first), **found)


def _mean(values: Array, group: NDArray[np.int_], count: Array) -> Array:
    """Return the mean of each group, NaN if one of its values is missing."""
    flat = values.reshape(len(values), -1)
    sums = np.stack([np.bincount(group, flat[:, k], len(count)) for k in range(flat.shape[1])], axis=1)
    return np.asarray((sums / count[:, None]).reshape(len(count), *values.shape[1:]))


def _sigma(values: Array, stated: Array | None, group: NDArray[np.int_], count: Array) -> Array | None:
    """Return the standard deviation of each mean, from the pooled scatter, or from stated ones if there is none."""
    off = values - _mean(values, group, count)[group]
    known = np.isfinite(off).all(axis=1)
    freedom = values.shape[1] * float(known.sum() - len(count))
    squares = float(np.sum(off[known] ** 2))
    if freedom > 0.0 and squares > 0.0:
        return np.asarray(np.sqrt(squares / freedom / count))
    return None if stated is None else np.asarray(np.sqrt(_mean(stated**2, group, count) / count))


def _part(values: Array | None, rows: NDArray[np.int_]) -> Array | None:
    return None if values is None else values[rows]
