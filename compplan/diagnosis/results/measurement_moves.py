"""Moves that a next measurement may consist of: new poses, loads, reversal, joint sweep, warm-up.

A pool of candidate moves is laid out as the continuation of a campaign, so that the forward models see order, loads,
times and temperatures as they would be. A move is a few rows that only make sense together, such as one pose with and
without load.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, NEGLIGIBLE, ROUNDING, SAMPLE, SEED
from compplan.effects import apply_effects, build_model, solve_model_poses, transmission_error
from compplan.effects.forward_model import Attained
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.measurement.campaign import Campaign
from compplan.measurement.pose_selection import take_clear
from compplan.robot import Array, Robot

#: Step of the finite differences of an exact model, in units of a parameter's scale (theory: its error, and that of a
#: model solved to rounding, are alike there).
NUDGE = float(np.sqrt(ROUNDING))


#: What each kind of move is, for people.
KINDS = {
    "new_poses": "measure these poses, without load",
    "loaded_unloaded": "measure each pose without load and under the load",
    "reversal": "come to each pose from either side of one joint",
    "joint_sweep": "sweep one joint over its range and hold the others",
    "warm_up": "let the robot cool down, then measure each pose cold, half warm and warm",
}
#: Backing off before a pose is approached from a side: assumed ample for any lost motion. [rad, m]
BACK_OFF = {"revolute": np.deg2rad(6.0), "prismatic": 0.05}


@dataclass(frozen=True)
class MoveSettings:
    """Numbers of the moves that are proposed."""

    #: Candidates of new poses, from which the telling ones are picked, and draws for each: some are not clear
    #: (assumed).
    poses: int = 40
    #: Seconds between stays and between runs; seconds at which a robot is cold, half warm and warm (assumed). [s]
    pace: float = 15.0
    course: tuple[float, ...] = (0.0, 1800.0, 7200.0)
    #: Warm-up at least, whatever the campaign saw (assumed). [K]
    assumed_rise: float = 8.0
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
    """Candidate rows under construction, and the moves among them; rows are (q, wrench, run, time, warmth)."""

    rows: list[tuple[Array, Array, str, float, float]] = field(default_factory=list)
    moves: list[MeasuringMove] = field(default_factory=list)
    clock: float = 0.0

    def add(
        self, q: Array, wrench: Array | None = None, run: str = "static_next", time: float | None = None,
        warmth: float = 1.0,
    ) -> int:  # fmt: skip
        """Append a row, at rest in its turn after the clock where no time is given, and return its number."""
        moment = self.clock + MOVES.pace * len(self.rows) if time is None else time
        self.rows.append((q, np.zeros(6) if wrench is None else wrench, run, moment, warmth))
        return len(self.rows) - 1

    def last(self) -> float:
        """Return the time of the latest row. [s]"""
        return max(row[3] for row in self.rows)


def list_moves(robot: Robot, campaign: Campaign, seed: int = SEED) -> tuple[Campaign, tuple[MeasuringMove, ...]]:
    """Lay out candidate moves as the continuation of a campaign: its first rows, then theirs; and list the moves.

    Poses stay within the joint limits, no lower and no nearer to the base axis than the campaign went; loads stay
    within the largest load of the campaign. Whether cables and surroundings allow a pose is not known here.
    """
    random = np.random.default_rng(seed)
    poses = draw_poses(robot, campaign, MOVES.poses, random)
    if not len(poses):
        return campaign.take(np.zeros(0, int)), ()
    before = np.flatnonzero(campaign.usable)[:5]
    pool = Pool([(campaign.q[row], campaign.wrench[row], "static_before", 0.0, 0.0) for row in before])
    _add_static(pool, campaign, poses)
    _add_reversals(pool, robot, poses)
    _add_sweeps(pool, robot, campaign, poses)
    if campaign.time is not None or campaign.temperature is not None:
        _add_warm_up(pool, poses)
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
    pool.clock = pool.last()
    for joint, unit in zip(robot.actuated, np.eye(robot.nq), strict=True):
        step = BACK_OFF[joint.kind] * unit
        for q in poses[:FEW_ROWS]:
            centre = np.clip(q, robot.lower + step, robot.upper - step)
            rows = [(pool.add(centre + side * step), pool.add(centre))[1] for side in (-1.0, 1.0)]
            pool.moves.append(MeasuringMove("reversal", tuple(rows), joint.name))


def _add_sweeps(pool: Pool, robot: Robot, campaign: Campaign, poses: Array) -> None:
    lower, upper = joint_range(robot, campaign)
    pool.clock = pool.last()
    for index, joint in enumerate(robot.actuated):
        for q in poses[:2]:
            sweep = np.repeat(q[None], ENOUGH_ROWS, axis=0)
            sweep[:, index] = np.linspace(lower[index], upper[index], ENOUGH_ROWS)
            sweep = sweep[keeps_clear(robot, campaign, sweep)]
            if len(sweep) >= FEW_ROWS:
                pool.moves.append(MeasuringMove("joint_sweep", tuple(pool.add(s) for s in sweep), joint.name))


def _add_warm_up(pool: Pool, poses: Array) -> None:
    rows = [
        [
            pool.add(q, None, "static_warming", seconds + MOVES.pace * number, warmth)
            for number, q in enumerate(poses[:ENOUGH_ROWS])
        ]
        for seconds, warmth in zip(MOVES.course, (0.0, 0.5, 1.0), strict=True)
    ]
    pool.moves += [MeasuringMove("warm_up", numbers) for numbers in zip(*rows, strict=True)]


def _continue_campaign(campaign: Campaign, pool: Pool) -> Campaign:
    n, temperature = len(pool.rows), None
    q, wrench, run, time, warmth = (np.array(part) for part in zip(*pool.rows, strict=True))
    if campaign.temperature is not None and campaign.warming is not None:
        rise = max(float(np.max(campaign.warming)), MOVES.assumed_rise)
        temperature = campaign.reference_temperature + rise * warmth
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


def probe_signature(at: Linearization, signature: Signature) -> Signature:
    """Return a claimed signature at further rows by finite differences of its exact forward model."""
    if signature.name == transmission_error.name:
        return _probe_curve(at, signature)
    twists, encoders = [], []
    for k, scale in enumerate(signature.scale):
        values = np.zeros(len(signature.scale))
        values[k] = NUDGE * scale
        moved = solve_model_poses(apply_effects(at.scene, [signature.effect(values)]))
        twist, encoder = _difference(at, moved, values[k])
        twists.append(twist)
        encoders.append(encoder)
    return replace(signature, twist=np.stack(twists, axis=-1), encoder=np.stack(encoders, axis=-1))


def _probe_curve(at: Linearization, signature: Signature) -> Signature:
    """Return a curve over a joint's angle at further rows: each row knows the joint's error there alone."""
    index, scene = at.scene.joint_index(signature.joint), at.scene
    nudge = NUDGE * float(signature.scale[0])
    moved = solve_model_poses(replace(scene, drive=scene.drive + nudge * (np.arange(at.robot.nq) == index)))
    twist, encoder = _difference(at, moved, nudge)
    angle, units = np.nan_to_num(at.campaign.q[:, index]), np.eye(len(signature.scale))
    shape = np.column_stack([transmission_error.error_at(signature.effect(unit), angle) for unit in units])
    return replace(signature, twist=twist[..., None] * shape[:, None], encoder=encoder[..., None] * shape[:, None])


def _difference(at: Linearization, moved: Attained, nudge: float) -> tuple[Array, Array]:
    """Return how target and link-side readings have moved per unit of a parameter. Shapes (n, 6), (n, nq)."""
    step = (moved.position - at.attained.position) / nudge
    turn = np.einsum("nij,nkj->nik", moved.rotation, at.attained.rotation) / nudge
    spin = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([step, spin], axis=1), (moved.link - at.attained.link) / nudge
