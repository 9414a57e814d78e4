"""Where a gap lies: the deviation that the nominal model leaves, split by joint, factor, direction, run and region.

Two ways of splitting. By joint and by factor: which joint's motion, spring or frame would have to err to produce it,
and what that error depends on. The few mechanisms that carry the deviation on rows left out of their fit
are selected; what they explain together is divided between them by Shapley values. By direction, run, time, load and
region: how much of the sum of squares lies there. Intervals come from drawing blocks of poses anew; they hold 95 %
where the mechanisms are the right ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.pattern_fit import Cell, PatternFit, Share, find_interval
from compplan.diagnose.patterns import BASE, FACTORS, NOWHERE, TOOL, build_nuisance, build_patterns
from compplan.diagnose.traces import Trace, trace_cells
from compplan.errors import ShapeError
from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

if TYPE_CHECKING:
    from compplan.diagnose.result import Diagnosis

BLOCKS = 40
DRAWS = 400
#: Rows that are used at most; longer logs are thinned evenly.
ROWS = 6000
#: Rows that a region, a load or a stretch of time needs to be listed.
FEWEST = 5
#: Robust standard deviations beyond which a row is left out where the caller does not say which rows count.
OUTLYING = 8.0


@dataclass(frozen=True, eq=False)
class Split:
    """Where a gap lies.

    Attributes:
        rms: Deviation over the rows used, 3D. [m]
        cells: Place and mechanism of what carries the deviation, in the order in which they were found.
        by_joint: Share that each joint's motion, spring or frame produces; besides joints: base, tool, and runs and
            time.
        by_factor: Share that depends on each factor.
        alone: By place and mechanism: share that this could explain alone, whatever else does.
        noise: Share that noise explains.
        unexplained: Share that no pattern and no noise explains.
        by_axis: Share along x, y, z of the base, and along the tool's z.
        by_run: One entry a run: rows, rms, share, mean deviation.
        by_time: One entry a stretch of the log, in order.
        by_load: One entry a level of external force.
        by_approach: By joint: how far the point moves when the joint's last move turns round.
        by_region: One entry a region of the workspace.
        traces: Errors that the carrying joints would have to make, over what they depend on; for pictures.
    """

    rms: float
    cells: tuple[Cell, ...]
    by_joint: dict[str, Share]
    by_factor: dict[str, Share]
    alone: dict[str, dict[str, float]]
    noise: float
    unexplained: float
    by_axis: dict[str, Share]
    by_run: dict[str, dict[str, Any]]
    by_time: list[dict[str, Any]]
    by_load: list[dict[str, Any]]
    by_approach: dict[str, dict[str, float]]
    by_region: list[dict[str, Any]]
    traces: tuple[Trace, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return what stands under `where` in diagnosis.json."""
        return {
            "rms_mm": 1e3 * self.rms,
            "carried_by": [{"place": place, "mechanism": mechanism} for place, mechanism in self.cells],
            "by_joint": {name: share.to_json() for name, share in self.by_joint.items()},
            "by_factor": {name: share.to_json() for name, share in self.by_factor.items()},
            "by_joint_alone": self.alone,
            "noise_share": self.noise,
            "unexplained_share": self.unexplained,
            "by_axis": {name: share.to_json() for name, share in self.by_axis.items()},
            "by_run": self.by_run,
            "by_time": self.by_time,
            "by_load": self.by_load,
            "by_approach": self.by_approach,
            "by_region": self.by_region,
        }


def split_deviation(
    robot: Robot,
    campaign: Campaign,
    deviation: Array,
    *,
    registration: Registration | None = None,
    used: NDArray[np.bool_] | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> Split:
    """Split the deviation that the nominal model leaves by joint, factor, direction, run, time, load and region.

    Args:
        robot: The nominal robot.
        campaign: The measurement log.
        deviation: Measured minus predicted point, base axes. Shape (n, 3). [m]
        registration: Frames fitted to the campaign before; they are then no explanation.
        used: Rows that count: usable and no outliers; where left out, usable and not far beyond the rest. Shape (n,).
        noise: Noise floor, rms of the 3D distance. [m]
        seed: Seed of the blocks and draws.

    Raises:
        ShapeError: If the deviation does not have one row a row of the campaign.
    """
    deviation = np.asarray(deviation, float)
    if deviation.shape != (len(campaign), 3):
        raise ShapeError(f"deviation has shape {deviation.shape}, expected ({len(campaign)}, 3)")
    rows = _choose_rows(campaign, deviation, used)
    rng = np.random.default_rng(seed)
    block = _draw_blocks(campaign, rng)[rows]
    blocks = int(block.max()) + 1
    draws = rng.multinomial(blocks, np.full(blocks, 1 / blocks), size=DRAWS).astype(float)
    taken, left = campaign.q[rows], deviation[rows]
    patterns = build_patterns(robot, campaign, np.nan_to_num(deviation), rows, registration)
    nuisance = build_nuisance(robot, campaign, rows, registration)
    fit = PatternFit(patterns, nuisance, left, block)
    cells = fit.select()
    total = float((left**2).sum(1).mean())
    noise_share = float(np.clip(noise**2 / max(total, 1e-300), 0, 1))
    frames = locate_frames(build_chain(robot), taken)
    table = _Shares(left, block, draws)
    places = [name for name in (*robot.joint_names, BASE, TOOL, NOWHERE) if name in patterns.place]
    factors = [name for name in FACTORS if name in patterns.factor]
    return Split(
        rms=float(np.sqrt(total)),
        cells=tuple(cells),
        by_joint=_divide(
            fit, {name: fit.find([cell for cell in fit.cells if cell[0] == name]) for name in places}, cells, draws
        ),
        by_factor=_divide(fit, {name: fit.find(fit.cells, name) for name in factors}, cells, draws),
        alone={place: _explain_alone(fit, place) for place in places},
        noise=noise_share,
        unexplained=float(np.clip(1 - fit.explain(fit.find(cells)) - noise_share, 0, 1)),
        by_axis={
            **{axis: table.along(np.eye(3)[k]) for k, axis in enumerate("xyz")},
            "tool_z": table.along(frames.tcp_rotation[:, :, 2]),
        },
        by_run=_split_runs(table, campaign.run[rows]),
        by_time=_split_time(table, campaign, rows),
        by_load=_split_load(table, campaign, rows),
        by_approach=_split_approach(fit, robot),
        by_region=_split_region(table, frames.tcp_position),
        traces=trace_cells(patterns, nuisance, left, cells, robot.joint_names, taken),
    )


def split_diagnosis(diagnosis: Diagnosis, seed: int = 0) -> Split:
    """Split the gap of a diagnosis: what its nominal robot leaves, outliers left out.

    Args:
        diagnosis: The diagnosis.
        seed: Seed of the blocks and draws.
    """
    campaign = diagnosis.fit.problem.campaign
    used = np.ones(len(campaign), bool)
    used[diagnosis.outliers] = False
    return split_deviation(
        diagnosis.robot,
        campaign,
        diagnosis.residual_before,
        registration=diagnosis.registration,
        used=used,
        noise=diagnosis.gap.noise_floor,
        seed=seed,
    )


def _divide(fit: PatternFit, columns: dict[str, NDArray[np.int_]], cells: list[Cell], draws: Array) -> dict[str, Share]:
    """Divide what the cells explain between named columns; a name without a part gets what it could add at most."""
    carrying = fit.find(cells)
    parts = {name: np.intersect1d(own, carrying) for name, own in columns.items()}
    named = [name for name, part in parts.items() if len(part)]
    shares = dict(zip(named, fit.divide([parts[name] for name in named], draws), strict=True))
    before = fit.gain(carrying)
    for name, own in columns.items():
        if name not in shares:
            more = fit.gain(np.union1d(carrying, own)) - before
            shares[name] = Share(0.0, 0.0, find_interval(more, fit.square, draws).high)
    return {name: shares[name] for name in columns}


def _explain_alone(fit: PatternFit, place: str) -> dict[str, float]:
    cells = [cell for cell in fit.cells if cell[0] == place]
    return {cell[1]: round(max(fit.explain(fit.find([cell])), 0.0), 4) for cell in cells}


class _Shares:
    """Sums of squared deviation over parts of the rows, with intervals over drawn blocks."""

    def __init__(self, deviation: Array, block: NDArray[np.int_], draws: Array) -> None:
        self.deviation, self.block, self.draws = deviation, block, draws
        self.size = (deviation**2).sum(1)
        self.blocks = draws.shape[1]

    def of(self, square: Array) -> Share:
        """Share of squares, one a row, of the whole."""
        parts = np.bincount(self.block, square, self.blocks)
        whole = np.bincount(self.block, self.size, self.blocks)
        return find_interval(parts.astype(float), whole.astype(float), self.draws)

    def along(self, direction: Array) -> Share:
        """Share along a direction, fixed or one a row."""
        return self.of((self.deviation * direction).sum(1) ** 2)

    def describe(self, inside: NDArray[np.bool_]) -> dict[str, Any]:
        """Describe part of the rows: how many, rms, share of all squares, mean deviation."""
        rms = float(np.sqrt(self.size[inside].mean()))
        mean = 1e3 * self.deviation[inside].mean(axis=0)
        entry = {"rows": int(inside.sum()), "rms_mm": round(1e3 * rms, 6)}
        return {**entry, **self.of(self.size * inside).to_json(), "mean_mm": [round(float(value), 6) for value in mean]}


def _choose_rows(campaign: Campaign, deviation: Array, used: NDArray[np.bool_] | None) -> NDArray[np.int_]:
    usable = campaign.usable & np.isfinite(deviation).all(1)
    if used is None:
        size = np.linalg.norm(np.nan_to_num(deviation), axis=1)
        middle = float(np.median(size[usable]))
        spread = 1.4826 * float(np.median(np.abs(size[usable] - middle)))
        used = size <= middle + OUTLYING * max(spread, 1e-9)
    rows = np.flatnonzero(usable & used)
    return rows[:: -(-len(rows) // ROWS)] if len(rows) > ROWS else rows


def _draw_blocks(campaign: Campaign, rng: np.random.Generator) -> NDArray[np.int_]:
    """Put rows into blocks: static rows of one pose together, rows of a path in stretches. Shape (n,)."""
    _, pose = np.unique(campaign.pose, return_inverse=True)
    label = rng.permutation(pose.max() + 1)[pose]
    on_path = campaign.on_path
    for run in np.unique(campaign.run_index[on_path]):
        inside = np.flatnonzero(on_path & (campaign.run_index == run))
        stretches = max(len(inside) // 15, 1)
        start = int(label.max()) + 1
        label[inside] = start + np.arange(len(inside)) * stretches // len(inside)
    _, block = np.unique(label % BLOCKS, return_inverse=True)
    return np.asarray(block)


def _split_runs(table: _Shares, run: NDArray[np.str_]) -> dict[str, dict[str, Any]]:
    return {str(name): table.describe(run == name) for name in dict.fromkeys(run.tolist())}


def _split_time(table: _Shares, campaign: Campaign, rows: NDArray[np.int_]) -> list[dict[str, Any]]:
    """Split the log into up to eight stretches with equally many rows."""
    count = min(8, max(len(rows) // 20, 1))
    stretch = np.arange(len(rows)) * count // len(rows)
    entries = []
    for number in range(count):
        inside = stretch == number
        entry: dict[str, Any] = {"rows_from": int(rows[inside][0]), "rows_to": int(rows[inside][-1])}
        if campaign.time is not None:
            entry["time_s"] = [round(float(campaign.time[row]), 3) for row in rows[inside][[0, -1]]]
        entries.append({**entry, **table.describe(inside)})
    return entries


def _split_load(table: _Shares, campaign: Campaign, rows: NDArray[np.int_]) -> list[dict[str, Any]]:
    """Split the rows into unloaded ones and three levels of force."""
    force = np.linalg.norm(np.nan_to_num(campaign.wrench[rows, :3]), axis=1)
    loaded = ~campaign.unloaded[rows]
    level = np.zeros(len(rows), int)
    if loaded.any():
        edges = np.unique(np.percentile(force[loaded], (100 / 3, 200 / 3)))
        level[loaded] = 1 + np.searchsorted(edges, force[loaded])
    entries = []
    for number in np.unique(level):
        inside = level == number
        if inside.sum() >= FEWEST:
            reach = [round(float(force[inside].min()), 1), round(float(force[inside].max()), 1)]
            entries.append({"force_N": reach, **table.describe(inside)})
    return entries


def _split_approach(fit: PatternFit, robot: Robot) -> dict[str, dict[str, float]]:
    """Tell for each joint how far it stands apart when approached from either side, all patterns fitted together."""
    everything = np.arange(len(fit.patterns.place))
    unknown = fit.fit(everything) / fit.length
    entries = {}
    for name in robot.joint_names:
        found = fit.find([(name, "lost motion")])
        if len(found):
            values = -2e3 * unknown[:, found[0]]
            spread = float(np.sqrt((fit.folds - 1) * values.var()))
            unit = "lost_motion_mm" if fit.patterns.unit[found[0]] == "m" else "lost_motion_mrad"
            entries[name] = {unit: round(float(values.mean()), 6), "standard_error": round(spread, 6)}
    return entries


def _split_region(table: _Shares, position: Array) -> list[dict[str, Any]]:
    """Split the workspace by reach from the base axis and by height, three parts each."""
    reach, height = np.hypot(position[:, 0], position[:, 1]), position[:, 2]
    parts = []
    for values in (reach, height):
        edges = np.percentile(values, (0, 100 / 3, 200 / 3, 100))
        parts.append((np.clip(np.searchsorted(edges[1:-1], values, side="right"), 0, 2), edges))
    (ring, ring_edges), (layer, layer_edges) = parts
    entries = []
    for i in range(3):
        for j in range(3):
            inside = (ring == i) & (layer == j)
            if inside.sum() >= FEWEST:
                limits = {
                    "reach_mm": [round(1e3 * float(value), 1) for value in ring_edges[i : i + 2]],
                    "height_mm": [round(1e3 * float(value), 1) for value in layer_edges[j : j + 2]],
                }
                entries.append({**limits, **table.describe(inside)})
    return entries
