"""Causes without a name in the format's list: bolts, bearings, hoses, tanks and balancers of the arm."""

from __future__ import annotations

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, elastic_joints, largest, name_unknown
from benchmarks.outsider.robots import SCALE, Robot, Spring, joint_name
from benchmarks.outsider.statics import Frames, Pull, State
from benchmarks.outsider.turns import AXES, GRAVITY, Array, Rng, dot, repeat, rotate, transpose

HOSE_N = {"cobot": 25.0, "small": 60, "mid": 250, "heavy": 900, "scara": 30}
TANK_KG = {"cobot": 6, "small": 5, "mid": 20, "heavy": 160, "scara": 3}


def hose_pull(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The dress pack pulls at the wrist once it is stretched."""
    wrist, scale = joint_name(max(1, robot.count - 2)), SCALE[robot.size]
    clip = np.array([-0.1 * scale, 0.15 * scale, robot.reach * 0.75])
    length = np.linalg.norm(campaign.position - clip, axis=1)
    slack, rate = np.quantile(length, rng.uniform(0.3, 0.6)), 1.0 / np.ptp(length)

    def apply(state: State, on: Campaign, size: float) -> None:
        def pull(frames: Frames) -> Pull:
            point = frames[wrist].origin + rotate(frames[wrist].rotation, np.array([0, 0.1, 0.08]))
            hose = clip - point
            stretched = np.linalg.norm(hose, axis=1)
            force = size * np.maximum(0, (stretched - slack) * rate + 0.1 * np.sin(3 * on.q[:, -1]))
            return Pull(wrist, force[:, None] * hose / stretched[:, None], point)

        state.pulls.append(pull)

    note = "the dress pack pulls at the wrist once it is stretched, more when the wrist is turned (N)"
    force = HOSE_N[robot.size]
    return name_unknown("hose_pull", note, apply, force, 0.05 * force, 2.5 * force)


def loose_bolt_rock(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A link rocks from one seat to the other beyond a moment."""
    k = int(rng.choice(robot.turning[:4]))
    name, axis = joint_name(k), robot.across(k)[int(rng.integers(2))]

    def moment(on: Campaign) -> Array:
        frame, (force, total) = on.nominal.frames[name], on.nominal.carried[name]
        return dot(rotate(frame.rotation, AXES[axis]), total - np.cross(frame.origin, force))

    given = moment(campaign)
    limit, width = np.quantile(given, rng.uniform(0.3, 0.7)), 0.03 * np.ptp(given) + 1e-9

    def apply(state: State, on: Campaign, size: float) -> None:
        rock = 0.5 * size * np.tanh((moment(on) - limit) / width)
        state.springs.append(Spring(name, "r" + axis, 0.0, (0, 0, 0.05), lambda torque, compliance: rock))

    note = "a loose bolt lets the link rock from one seat to the other once the moment passes a threshold (rad)"
    return name_unknown("loose_bolt_rock", note, apply, 6e-4, params={"axis": "r" + axis}, joint=name)


def balancer_run(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The hydraulic balancer loses pressure and its seals drag."""
    k = (robot.leaning() or elastic_joints(robot, campaign)[0])[0]
    name = joint_name(k)
    top, decay = largest(campaign.torque(name)), rng.uniform(1500, 4000)

    def apply(state: State, on: Campaign, size: float) -> None:
        q = on.q[:, k]
        seals = 0.8 * np.tanh(on.direction[:, k] * np.minimum(1, on.step[:, k] / 0.4)) * (0.3 + np.abs(np.sin(q)))
        pressure = 0.2 if on.fresh else np.exp(-on.time / decay)
        state.load_joint(name, size * (seals - 1.2 * np.sin(q) * pressure))

    note = (
        "the hydraulic balancer loses pressure over the run and its seals drag by the direction of the last move (N m)"
    )
    return name_unknown("balancer_run", note, apply, 0.4 * top, 0.03 * top, 2 * top, needs=("balancer",))


def bearing_wobble(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint's axis tumbles two to four times a turn."""
    k = int(rng.choice(robot.turning[:4]))
    name, phases = joint_name(k), rng.uniform(0, 6.3, 3)
    first, second = (AXES[a] for a in robot.across(k)[:2])
    rate = int(rng.choice([2, 3, 4]))

    def apply(state: State, on: Campaign, size: float) -> None:
        q = on.q[:, k]
        about_second = 0.6 * np.sin((rate + 1) * q + phases[1]) + 0.4 * np.sin(rate * q + phases[2])
        by = np.sin(rate * q + phases[0])[:, None] * first + about_second[:, None] * second
        state.turn(name, size * by)

    note = "the main bearing's race is out of round: the joint's axis tumbles two to four times a turn (rad)"
    return name_unknown("bearing_wobble", note, apply, 4e-4, joint=name)


def tank_empties(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A tank on the forearm runs empty and sloshes."""
    full, share, scale = TANK_KG[robot.size], rng.uniform(0.3, 0.9), SCALE[robot.size]
    name = joint_name(robot.count - 3 if robot.count > 4 else 1)

    def apply(state: State, on: Campaign, size: float) -> None:
        left = np.clip(1 - on.time / on.time.max() / share, 0, 1) * (0.3 if on.fresh else 1)
        up = rotate(transpose(on.nominal.frames[name].rotation), repeat(AXES["z"], on.rows))
        place = (np.array([0.1, 0.25, 0.1]) - 0.25 * up) * scale

        def pull(frames: Frames) -> Pull:
            point = frames[name].origin + rotate(frames[name].rotation, place)
            return Pull(name, (size * left)[:, None] * GRAVITY, point)

        state.pulls.append(pull)

    note = "a tank on the forearm runs empty during the run and sloshes to its lowest corner (kg when full)"
    return name_unknown("tank_empties", note, apply, 0.5 * full, 0.03 * full, 3 * full)


def sunlit_arm(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The sun bows the upper arm while it stands in the beam."""
    warming, beam = rng.uniform(1800, 5000), rng.uniform(0, 6.3)
    k = next(k for k in robot.turning if abs(robot.movers[k].axis[2]) < 0.5 or robot.size == "scara")
    e = robot.movers[k + 1]
    bow = 0.4 * np.linalg.norm(e.xyz) * np.array([0.6, 0.4, 0])

    def apply(state: State, on: Campaign, size: float) -> None:
        azimuth = np.arctan2(on.position[:, 1], on.position[:, 0])
        warm = size * np.maximum(0, np.cos(azimuth - beam)) * (1 - np.exp(-on.later(3000) / warming))
        state.turn(e.name, warm[:, None] * np.array([0.5, 1, 0.2]))
        state.shift(e.name, -warm[:, None] * bow)

    note = (
        "the sun through the roof light bows the upper arm while it stands in the beam, more as the day goes on (rad)"
    )
    return name_unknown("sunlit_arm", note, apply, 8e-4, joint=e.name)


def cable_tray_drag(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The energy chain's drag remembers the last few moves."""
    columns, _ = elastic_joints(robot, campaign)
    k = robot.column_1 if robot.column_1 in columns else columns[0]
    second, lag = columns[1], rng.uniform(0.3, 0.8)
    middle, spread = campaign.position[:, 2].mean(), np.std(campaign.position[:, 2]) + 1e-9

    def apply(state: State, on: Campaign, size: float) -> None:
        q, drag, now = on.q[:, k], np.zeros(on.rows), 0.0
        for i in range(on.rows):
            now = now * lag + (1 - lag) * np.tanh((q[i] - q[i - 1]) / 0.6 if i else 0.0)
            drag[i] = now
        up = (on.position[:, 2] - middle) / spread
        torque = size * (drag * (1 + 0.5 * up) + 0.3 * np.tanh(2 * (q - np.median(q))) * up)
        state.load_joint(joint_name(k), -torque)
        state.load_joint(joint_name(second), 0.5 * torque * np.cos(on.q[:, second]))

    top = max(0.5 * float(np.abs(campaign.torque(joint_name(second))).max()), 5.0)
    note = "the energy chain drags at the column: a moment that remembers the last few moves (N m)"
    return name_unknown("cable_tray_drag", note, apply, 0.4 * top, 0.03 * top, 4 * top)
