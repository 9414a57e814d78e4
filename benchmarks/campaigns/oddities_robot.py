"""Causes in the robot that have no name in the vocabulary, as robot engineers and metrologists meet them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.campaigns.description import Array, Spring
from benchmarks.campaigns.effects import Effect, joint_index
from benchmarks.campaigns.oddity import Generator, Oddity, Place, Setting, add_bend, add_turn, draw_joint, draw_unit
from benchmarks.campaigns.simulate import Rows, Scenario, rotation_step

# --- hoses, cables, weights ---------------------------------------------------------------------------------------


def _draw_hose(rng: Generator, s: Setting) -> Place:
    anchor = rng.uniform(-0.3, 0.3, 3) * s.machine.reach + np.array([0.0, 0.0, 0.7 * s.machine.reach])
    return None, 60.0, {"anchor_m": anchor.tolist(), "slack_m": 0.35 * s.machine.reach}


def _apply_hose(e: Effect, s: Scenario) -> Scenario:
    """The hose hangs slack up to a length and then pulls with the 1.5th power of what is missing."""

    def load(rows: Rows, p: Array, r: Array) -> Array:
        arm = np.array(e.params["anchor_m"]) - p
        length = np.linalg.norm(arm, axis=1)
        pull = e.size * np.maximum(length - e.params["slack_m"], 0.0) ** 1.5
        return np.concatenate([arm * (pull / length)[:, None], np.zeros_like(arm)], axis=1)

    return replace(s, loads=(*s.loads, load))


def _apply_dangling(e: Effect, s: Scenario) -> Scenario:
    """A cable lies on the floor: the higher the tool, the more of it hangs on the tool."""

    def load(rows: Rows, p: Array, r: Array) -> Array:
        wrench = np.zeros((len(p), 6))
        wrench[:, 2] = -9.81 * e.size * np.maximum(p[:, 2] - e.params["floor_m"], 0.0)
        sideways = p[:, :2] - np.array(e.params["drum_m"])
        wrench[:, :2] = 0.35 * wrench[:, 2:3] * sideways / (np.linalg.norm(sideways, axis=1)[:, None] + 0.1)
        return wrench

    return replace(s, loads=(*s.loads, load))


def _apply_dress_pack(e: Effect, s: Scenario) -> Scenario:
    """The dress pack is wound up by the wrist: a torque with the third power of the winding, on two joints."""

    def winding(joint: str, stiffness: float) -> Callable[[Rows], Array]:
        j = joint_index(s.description, joint)

        def torque(rows: Rows) -> Array:
            wound = rows.q[:, j] - e.params["free_rad"]
            return np.asarray(-e.size * stiffness * np.tanh(wound) * wound**2)

        return torque

    springs = [(joint, s.own_springs(joint)[0]) for joint in e.params["joints"]]
    added = tuple((k, winding(joint, 1.0 / float(s.compliance[k]))) for joint, k in springs)
    return replace(s, torques=(*s.torques, *added))


def _draw_dress_pack(rng: Generator, s: Setting) -> Place:
    soft = [n for n in s.arm[-3:] if s.nominal.own_springs(n)]
    return soft[0], 1e-4, {"joints": soft[:2], "free_rad": float(rng.uniform(-1.0, 1.0))}


# --- feet, rails, bearings ----------------------------------------------------------------------------------------


def _apply_loose_foot(e: Effect, s: Scenario) -> Scenario:
    """One foot is not bolted down: the base rocks about an edge once the tool leans out over it."""
    edge = np.array(e.params["edge"])
    about = np.array([-edge[1], edge[0], 0.0])

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        lean = p[:, :2] @ edge[:2] - rows.wrench[:, 2] * e.params["per_N"] * (p[:, :2] @ edge[:2])
        rock = e.size * np.clip((lean - e.params["threshold_m"]) / e.params["soft_m"], 0.0, 1.0)
        turn = np.array([rotation_step(v * about) for v in rock])
        pivot = 0.25 * e.params["threshold_m"] * edge
        return np.einsum("nij,nj->ni", turn, p - pivot) + pivot, turn @ r

    return replace(s, instrument=(see, *s.instrument))


def _draw_loose_foot(rng: Generator, s: Setting) -> Place:
    bearing = float(rng.uniform(0, 2 * np.pi))
    reach = s.machine.reach
    params = {
        "edge": [float(np.cos(bearing)), float(np.sin(bearing)), 0.0],
        "threshold_m": float(rng.uniform(-0.1, 0.25)) * reach,
        "soft_m": 0.08 * reach,
        "per_N": 0.5 / (9.81 * s.machine.payload_kg),
    }
    return None, 1e-4, params


def _apply_slew(e: Effect, s: Scenario) -> Scenario:
    """The slewing ring is not flat: the column nods with lobes over the angle of the first turning joint."""
    first = next(n for n in s.description.joint_names if n != "rail")
    j = joint_index(s.description, first)

    def nod(phase: float) -> Callable[[Rows], Array]:
        return lambda rows: e.size * np.abs(np.sin(0.5 * e.params["lobes"] * rows.q[:, j] + phase))

    s = add_bend(s, first, np.array([1.0, 0.0, 0.0]), nod(e.params["phase"]))
    return add_bend(s, first, np.array([0.0, 1.0, 0.0]), nod(e.params["phase"] + 0.9))


def _apply_rail_floor(e: Effect, s: Scenario) -> Scenario:
    """The floor under the rail is not level: the carriage rolls and pitches with its position."""

    def roll(rows: Rows) -> Array:
        x = rows.q[:, 0]
        return np.asarray(
            e.size * (np.sin(2.1 * x + e.params["phase"]) + 0.5 * np.tanh(3.0 * (x - e.params["step_m"])))
        )

    return add_bend(s, "rail", np.array(e.params["about"]), roll)


def _apply_runout(e: Effect, s: Scenario) -> Scenario:
    """A bearing is oval: its link moves sideways twice a turn."""
    j = joint_index(s.description, e.joint)

    def aside(lag: float) -> Callable[[Rows], Array]:
        return lambda rows: e.size * np.sin(2.0 * rows.q[:, j] + e.params["phase"] + lag) ** 3 / 1e-12

    for axis, lag in ((e.params["axes"][0], 0.0), (e.params["axes"][1], 1.2)):
        s = s.add_spring(Spring(str(e.joint), axis, 1e-12))
        s = replace(s, torques=(*s.torques, (len(s.springs) - 1, aside(lag))))
    return s


def _draw_runout(rng: Generator, s: Setting) -> Place:
    joint = draw_joint(rng, s, 0, 4)
    own = np.abs(s.machine.robot.segments[s.machine.robot.index_of(joint)].axis)
    axes = [a for a, v in zip(("tx", "ty", "tz"), own, strict=True) if v < 0.5]
    return joint, 1e-4, {"axes": axes, "phase": float(rng.uniform(0, 6))}


def _apply_twist(e: Effect, s: Scenario) -> Scenario:
    """The sun comes round: one side of a link warms and the link bends, then the hall door opens."""

    def warm(rows: Rows) -> Array:
        time = rows.time + (2.0 * e.params["tau_s"] if rows.later else 0.0)
        gone = np.maximum(time - e.params["door_s"], 0.0)
        return np.asarray(e.size * (np.tanh(time / e.params["tau_s"]) - 1.2 * (1 - np.exp(-gone / e.params["cool_s"]))))

    return add_bend(s, str(e.joint), np.array(e.params["about"]), warm)


def _draw_twist(rng: Generator, s: Setting) -> Place:
    end = float(s.rows.time[-1])
    params = {
        "about": draw_unit(rng),
        "tau_s": float(rng.uniform(0.2, 0.5)) * end,
        "door_s": float(rng.uniform(0.4, 0.8)) * end,
        "cool_s": 0.1 * end,
    }
    return draw_joint(rng, s, 1, 4), 1e-4, params


# --- gears, brakes, servos ----------------------------------------------------------------------------------------


def _apply_cycloid(e: Effect, s: Scenario) -> Scenario:
    """A cycloidal gear remembers its torque: play operators of many widths over the torque, not over the angle."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]
    reference = e.params["torque_Nm"]

    def shift(rows: Rows, load: Array) -> Array:
        delta = np.zeros_like(rows.q)
        u = load[:, k] / reference
        for width in (0.3, 0.8, 1.6):
            at = u[0] - 0.3 * width
            for n, value in enumerate(u):
                at = min(max(at, value - width), value + width)
                delta[n, j] += e.size * (at - value)
        return delta

    return replace(s, after=(*s.after, shift))


def _apply_brake(e: Effect, s: Scenario) -> Scenario:
    """Where the controller waits long enough it sets the brakes, and the joint drops into them with its torque."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]

    def shift(rows: Rows, load: Array) -> Array:
        visit = rows.visit
        fell = np.random.default_rng(e.params["seed"] + int(rows.later)).random(int(visit[-1]) + 1) < 0.45
        delta = np.zeros_like(rows.q)
        delta[:, j] = e.size * fell[visit] * np.tanh(load[:, k] / e.params["torque_Nm"])
        return delta

    return replace(s, after=(*s.after, shift))


def _draw_torque(rng: Generator, s: Setting) -> Place:
    sprung = [n for n in s.arm if s.nominal.own_springs(n)]
    heavy = sorted(sprung, key=s.torque_of)[-3:]
    joint = str(rng.choice(heavy))
    return joint, 1e-4, {"torque_Nm": s.torque_of(joint), "seed": int(rng.integers(2**31))}


def _apply_slip(e: Effect, s: Scenario) -> Scenario:
    """A belt jumps or a clamp slips a little at every long move of a joint, and never comes back."""
    j = joint_index(s.description, e.joint)

    def gone(rows: Rows) -> Array:
        move = np.diff(rows.q[:, j], prepend=rows.q[0, j])
        slip = np.where(np.abs(move) > e.params["longer_than_rad"], np.sign(move) * 0.3 + 0.7, 0.0)
        return np.asarray(np.cumsum(slip) / max(1.0, 0.2 * len(move)) + (2.0 if rows.later else 0.0))

    return add_turn(s, e.joint, gone, e.size)


def _apply_short_moves(e: Effect, s: Scenario) -> Scenario:
    """A servo with dead band stops short of its target, the more so the shorter the move was."""
    j = joint_index(s.description, e.joint)

    def short(rows: Rows) -> Array:
        move = np.diff(rows.q[:, j], prepend=rows.q[0, j] - 1.0)
        held, out = 0.0, np.zeros(len(move))
        for n, step in enumerate(move):
            if abs(step) > 1e-9:
                held = -np.sign(step) / (1.0 + (abs(step) / e.params["scale_rad"]) ** 2)
            out[n] = held
        return out

    return add_turn(s, e.joint, short, e.size)


def _apply_sinking(e: Effect, s: Scenario) -> Scenario:
    """Grease squeezes out of a bearing: a joint sinks with the logarithm of the time since it last moved far."""
    j = joint_index(s.description, e.joint)

    def sunk(rows: Rows) -> Array:
        move = np.diff(rows.q[:, j], prepend=rows.q[0, j] - 9.0)
        since, out = 0.0, np.zeros(len(move))
        for n, step in enumerate(move):
            wait = rows.time[n] - rows.time[n - 1] if n else 30.0
            since = wait if abs(step) > e.params["far_rad"] else since + wait
            out[n] = np.log1p(since / 5.0)
        return out - np.log1p(6.0)

    return add_turn(s, e.joint, sunk, e.size)


def _apply_cross(e: Effect, s: Scenario) -> Scenario:
    """A housing gives way: the square of one joint's torque turns the joint before it."""
    j = joint_index(s.description, e.params["turns"])
    k = s.own_springs(str(e.joint))[0]

    def shift(rows: Rows, load: Array) -> Array:
        delta = np.zeros_like(rows.q)
        delta[:, j] = e.size * (load[:, k] / e.params["torque_Nm"]) ** 2 * np.sign(np.sin(rows.q[:, j]))
        return delta

    return replace(s, after=(*s.after, shift))


def _draw_cross(rng: Generator, s: Setting) -> Place:
    joint, size, params = _draw_torque(rng, s)
    place = s.arm.index(str(joint))
    return joint, size, {**params, "turns": s.arm[place - 1 if place else 1]}


def _apply_tooth(e: Effect, s: Scenario) -> Scenario:
    """Some teeth are damaged: the joint falls in at a few angles, but only while torque presses it one way."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]

    def shift(rows: Rows, load: Array) -> Array:
        delta = np.zeros_like(rows.q)
        dent = sum(np.maximum(1.0 - np.abs(rows.q[:, j] - c) / e.params["wide_rad"], 0.0) for c in e.params["at_rad"])
        delta[:, j] = e.size * dent * (load[:, k] > 0.0)
        return delta

    return replace(s, after=(*s.after, shift))


def _draw_tooth(rng: Generator, s: Setting) -> Place:
    joint, size, params = _draw_torque(rng, s)
    angle = s.rows.q[:, s.machine.robot.joint_names.index(str(joint))]
    at = rng.choice(np.unique(angle), 3, replace=False)
    return joint, size, {**params, "at_rad": at.tolist(), "wide_rad": 0.12 * float(np.ptp(angle))}


def _apply_pin(e: Effect, s: Scenario) -> Scenario:
    """The tool's locating pin has slop: the tool hangs to whichever side its weight pulls it."""
    lever = np.array(e.params["lever_m"])

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        down = r[:, 2, :]  # the vertical in TCP axes
        side = np.tanh(down[:, :2] @ np.array(e.params["soft_way"]) / 0.15)
        turn = np.array([rotation_step(np.array([0.0, 0.0, e.size * v])) for v in side])
        moved = p + np.einsum("nij,nj->ni", r, np.einsum("nij,j->ni", turn, lever) - lever)
        return moved, r @ turn

    return replace(s, instrument=(see, *s.instrument))


def _draw_pin(rng: Generator, s: Setting) -> Place:
    way = rng.normal(size=2)
    lever = [float(v) for v in rng.normal(size=2) * 0.15] + [0.0]
    return None, 1e-4, {"lever_m": lever, "soft_way": (way / np.linalg.norm(way)).tolist()}


def _simple(low: int, high: int, **fixed: float) -> Callable[[Generator, Setting], Place]:
    def draw(rng: Generator, s: Setting) -> Place:
        return draw_joint(rng, s, low, high), 1e-4, {k: v * float(rng.uniform(0.7, 1.4)) for k, v in fixed.items()}

    return draw


def _draw_floor_cable(rng: Generator, s: Setting) -> Place:
    reach = s.machine.reach
    return None, 1.0, {"floor_m": 0.1 * reach, "drum_m": (rng.uniform(-1, 1, 2) * reach).tolist()}


def _draw_lobes(rng: Generator, s: Setting) -> Place:
    return s.arm[0], 1e-4, {"lobes": int(rng.choice([3, 4, 5])), "phase": float(rng.uniform(0, 3))}


def _draw_rail_floor(rng: Generator, s: Setting) -> Place:
    params = {"about": draw_unit(rng), "phase": float(rng.uniform(0, 6)), "step_m": float(rng.uniform(-1, 1))}
    return "rail", 1e-4, params


ROBOT_ODDITIES: dict[str, Oddity] = {
    "hose_tension": Oddity("a hose pulls the tool once its slack is used up (N/m^1.5)", _draw_hose, _apply_hose),
    "floor_cable": Oddity("a cable is lifted off the floor with the tool (kg/m)", _draw_floor_cable, _apply_dangling),
    "dress_pack": Oddity("the dress pack is wound up by the wrist (rad/rad^3)", _draw_dress_pack, _apply_dress_pack),
    "loose_foot": Oddity(
        "the base rocks on a loose foot when the arm leans out (rad)", _draw_loose_foot, _apply_loose_foot
    ),
    "slewing_ring": Oddity("the slewing ring is warped: the column nods as it turns (rad)", _draw_lobes, _apply_slew),
    "rail_floor": Oddity("the floor under the rail is not level (rad)", _draw_rail_floor, _apply_rail_floor, "rail"),
    "oval_bearing": Oddity("a bearing is oval: its link moves sideways twice a turn (m)", _draw_runout, _apply_runout),
    "sunny_side": Oddity("a link bends as one side warms, until a door opens (rad)", _draw_twist, _apply_twist),
    "cycloid_memory": Oddity("a cycloidal gear remembers the torque it had (rad)", _draw_torque, _apply_cycloid),
    "brake_drop": Oddity("brakes set at some stays; the joint drops into them (rad)", _draw_torque, _apply_brake),
    "slipping_clamp": Oddity(
        "a joint slips a little at every long move (rad)", _simple(0, 6, longer_than_rad=0.6), _apply_slip
    ),
    "short_moves": Oddity(
        "a servo stops short after short moves (rad)", _simple(0, 5, scale_rad=0.5), _apply_short_moves
    ),
    "grease_film": Oddity(
        "a joint sinks with the logarithm of its rest (rad)", _simple(0, 4, far_rad=0.35), _apply_sinking
    ),
    "soft_housing": Oddity("the square of a torque turns the joint before (rad)", _draw_cross, _apply_cross),
    "broken_teeth": Oddity("a joint falls into damaged teeth under torque one way (rad)", _draw_tooth, _apply_tooth),
    "pin_slop": Oddity("the tool turns in the slop of its pin (rad)", _draw_pin, _apply_pin),
}
