"""Moves that a next measurement may consist of: new poses, loads, reversal.

A pool of candidate moves is laid out as the continuation of a campaign, so that the forward models see order, loads,
times and temperatures as they would be. A move is a few rows that only make sense together, such as one pose with and
without load.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, NEGLIGIBLE, SAMPLE, SEED
from compplan.effects import build_model, solve_model_poses
from compplan.measurement.campaign import Campaign
from compplan.measurement.pose_selection import take_clear
from compplan.robot import Array, Robot

#: What each kind of move is, for people.
KINDS = {
    "new_poses": "measure these poses, without load",
    "loaded_unloaded": "measure each pose without load and under the load",
    "reversal": "come to each pose from either side of one joint",
}
#: Backing off before a pose is approached from a side: assumed ample for any lost motion. [rad, m]
BACK_OFF = {"revolute": np.deg2rad(6.0), "prismatic": 0.05}


@dataclass(frozen=True)
class MoveSettings:
    """Numbers of the moves that are proposed."""

    #: Candidates of new poses, from which the telling ones are picked, and draws for each: some are not clear
    #: (assumed).
    poses: int = 40
    #: Seconds between stays (assumed). [s]
    pace: float = 15.0
    #: Weight that is proposed where the campaign held no load: assumed possible for any robot here. [N]
    assumed_weight: float = 50.0
    #: Radius about the base axis beyond which it is always clear (assumed). [m]
    column: float = 0.3
    #: Moves of one kind at least, since a single reading may be a gross error, and at most; so many proposals at most,
    #: too (assumed).
    fewest_moves: int = 3
    most_moves: int = 8
    #: A proposal has to add this much expected probability (assumed).
    worth_it: float = 0.05


MOVES = MoveSettings()


@dataclass(frozen=True)
class MeasuringMove:
    """Rows of the pool that are measured together; `kind` is one of `KINDS`, `joint` the joint that it is about."""

    kind: str
    rows: tuple[int, ...]
    joint: str | None = None


@dataclass(eq=False)
class Pool:
    """Candidate rows under construction, and the moves among them; rows are (q, wrench, run, time)."""

    rows: list[tuple[Array, Array, str, float]] = field(default_factory=list)
    moves: list[MeasuringMove] = field(default_factory=list)
    clock: float = 0.0

    def add(self, q: Array, wrench: Array | None = None) -> int:
        """Append a row, at rest in its turn after the clock, and return its number."""
        moment = self.clock + MOVES.pace * len(self.rows)
        self.rows.append((q, np.zeros(6) if wrench is None else wrench, "static_next", moment))
        return len(self.rows) - 1


def list_moves(robot: Robot, campaign: Campaign, seed: int = SEED) -> tuple[Campaign, tuple[MeasuringMove, ...]]:
    """Lay out candidate moves as the continuation of a campaign: its first rows, then theirs; and list the moves.

    Poses stay within the joint limits, no lower and no nearer to the base axis than the campaign went; loads stay
    within the largest load of the campaign. Whether cables and surroundings allow a pose is not known here.
    """
    random = np.random.default_rng(seed)
    poses = draw_poses(robot, campaign, MOVES.poses, random)
    if not len(poses):
        return campaign.take(np.zeros(0, int)), ()
    before = np.flatnonzero(campaign.usable)[:FEW_ROWS]
    pool = Pool([(campaign.q[row], campaign.wrench[row], "static_before", 0.0) for row in before])
    _add_static(pool, campaign, poses)
    _add_reversals(pool, robot, poses)
    return _continue_campaign(campaign, pool), tuple(pool.moves)


def draw_poses(robot: Robot, campaign: Campaign, count: int, random: np.random.Generator) -> Array:
    """Draw poses within joint limits that keep clear of floor and column as the campaign did. Shape (<= count, nq)."""
    q = random.uniform(*joint_range(robot, campaign), (MOVES.poses * count, robot.nq))
    return take_clear([q], lambda part: keeps_clear(robot, campaign, part), count)


def joint_range(robot: Robot, campaign: Campaign) -> tuple[Array, Array]:
    """Return the joint range that may be visited. Shapes (nq,). [rad or m]"""
    seen = campaign.q[campaign.usable]
    middle = 0.5 * (seen.min(0) + seen.max(0))
    lower, upper = np.maximum(robot.lower, middle - np.pi), np.minimum(robot.upper, middle + np.pi)
    margin = NEGLIGIBLE * (upper - lower)
    # a rail is as long as it was seen to be where the folder states no limits
    endless = robot.prismatic & ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    return np.where(endless, seen.min(0), lower + margin), np.where(endless, seen.max(0), upper - margin)


def keeps_clear(robot: Robot, campaign: Campaign, q: Array) -> NDArray[np.bool_]:
    """Tell which poses stand no lower and no nearer to the base axis than the campaign did. Shape (n,)."""
    usable = np.flatnonzero(campaign.usable)
    some = usable[:: max(1, len(usable) // SAMPLE)]
    seen, tip = _tips(robot, campaign.q[some]), _tips(robot, q)
    near = min(float(np.hypot(seen[:, 0], seen[:, 1]).min()), MOVES.column)
    return np.asarray((tip[:, 2] >= seen[:, 2].min()) & (np.hypot(tip[:, 0], tip[:, 1]) >= near))


def _tips(robot: Robot, q: Array) -> Array:
    run = np.array(["static"] * len(q), dtype=np.str_)
    rows = Campaign(run, q, np.zeros((len(q), 6)), np.zeros((len(q), 3)))
    return solve_model_poses(build_model(robot, rows)).position


def given_loads(campaign: Campaign) -> list[Array]:
    """Pick the largest loads of the campaign that point in different directions; a known weight where it had none."""
    wrench = campaign.wrench[campaign.usable & ~campaign.unloaded]
    if not campaign.load_varies or not len(wrench):
        return [np.array([0.0, 0.0, -MOVES.assumed_weight, 0.0, 0.0, 0.0])]
    order = np.argsort(-np.linalg.norm(wrench[:, :3], axis=1))
    picked: list[Array] = []
    for row in order:
        force = wrench[row, :3]
        # nearer to a right angle than to each other
        size = np.linalg.norm(force) * np.sqrt(0.5)
        if all(force @ other[:3] < size * np.linalg.norm(other[:3]) for other in picked):
            picked.append(np.round(wrench[row], 1))
        if len(picked) == FEW_ROWS:
            break
    return picked


def _add_static(pool: Pool, campaign: Campaign, poses: Array) -> None:
    loads = given_loads(campaign)
    pool.clock = 0.0 if campaign.time is None else float(np.nanmax(campaign.time)) + MOVES.pace
    pool.moves += [MeasuringMove("new_poses", (pool.add(q),)) for q in poses]
    for number, q in enumerate(poses[:ENOUGH_ROWS]):
        load = loads[number % len(loads)]
        pool.moves.append(MeasuringMove("loaded_unloaded", (pool.add(q), pool.add(q, load))))


def _add_reversals(pool: Pool, robot: Robot, poses: Array) -> None:
    pool.clock = pool.rows[-1][3]
    for joint, unit in zip(robot.actuated, np.eye(robot.nq), strict=True):
        step = BACK_OFF[joint.kind] * unit
        for q in poses[:FEW_ROWS]:
            centre = np.clip(q, robot.lower + step, robot.upper - step)
            rows = [(pool.add(centre + side * step), pool.add(centre))[1] for side in (-1.0, 1.0)]
            pool.moves.append(MeasuringMove("reversal", tuple(rows), joint.name))


def _continue_campaign(campaign: Campaign, pool: Pool) -> Campaign:
    n, temperature = len(pool.rows), None
    q, wrench, run, time = (np.array(part) for part in zip(*pool.rows, strict=True))
    if campaign.temperature is not None and campaign.warming is not None:
        temperature = campaign.reference_temperature + float(np.max(campaign.warming)) * (run == "static_next")
    return Campaign(
        run=run.astype(np.str_),
        q=q,
        wrench=wrench,
        position=np.zeros((n, 3)),
        rotation=None if campaign.rotation is None else np.broadcast_to(np.eye(3), (n, 3, 3)),
        time=None if campaign.time is None else time,
        temperature=temperature,
        link=None if campaign.link is None else q.copy(),
        target=None if campaign.target is None else np.full(n, int(campaign.target_index[-1])),
        target_names=campaign.target_names,
    )
