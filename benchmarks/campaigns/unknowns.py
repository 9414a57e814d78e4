"""Effects that stand in no vocabulary: plausible on a real robot, foreign to a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.description import Array, Spring, rotation_from_rpy
from benchmarks.campaigns.effects import Apply, Effect, joint_index, play
from benchmarks.campaigns.simulate import Rows, Scenario, rotation_step, simulate_rows

# What each effect is, and whether it shows in path runs alone.
MEANING = {
    "hose_pull": "a hose from the column to the tool pulls with a force that grows with its stretch",
    "stick_scatter": "friction leaves a joint short of its target by an amount that differs from stay to stay",
    "loose_flange": "a loose flange tilts within a dead zone, as far as the moment on it pushes",
    "tracker_refraction": "air layers bend the tracker's beam: heights err with the square of the distance",
    "tracker_eccentricity": "the tracker's azimuth circle is eccentric: an error periodic in the line of sight",
    "tracker_scale": "the tracker's distances are a constant share too long",
    "force_cross_talk": "forces along one axis of the sensor show up along another",
    "creep": "a joint creeps under its load, with a time constant of minutes, and recovers",
    "path_vibration": "the arm swings at a resonance while it moves along a path",
    "load_dependent_backlash": "a gear lags behind by an amount that grows with the torque on it",
    "settling_foundation": "the foundation settles: the base tilts with the square root of time",
    "elastic_cross_coupling": "the torque on one joint bends the joint before it",
    "sun_on_link": "one-sided warming bends a link as time goes on",
    "friction_in_path": "friction holds back a joint in motion, more at low speed",
}
PATH_ONLY = {"path_vibration", "friction_in_path"}


def apply_unknown(effect: Effect, scenario: Scenario) -> Scenario:
    """Put an effect from outside the vocabulary into a scenario."""
    return APPLY_UNKNOWN[effect.name](effect, scenario)


@dataclass(frozen=True)
class Place:
    """Where an effect may sit, drawn for every one alike.

    Attributes:
        arm: Joints of the arm.
        big: Those of its first three that have springs of their own.
        joint: One of the first five.
        along: A direction. Shape (3,).
        station: Where the instrument stands. [m]
        phase: An angle. [rad]
    """

    arm: list[str]
    big: list[str]
    joint: str
    along: list[float]
    station: list[float]
    phase: float


def draw_unknown(rng: np.random.Generator, name: str, scenario: Scenario, rows: Rows) -> Effect:
    """Draw the shape of an effect from outside the vocabulary, at a size that is yet to be scaled."""
    arm = [n for n in scenario.description.joint_names if n != "rail"]
    big = [n for n in arm[:3] if scenario.own_springs(n)]
    joint = str(rng.choice(arm[:5]))
    along = rng.normal(size=3)
    station = [float(v) for v in rng.uniform(-1.0, 1.0, 3) * [4.0, 4.0, 0.3] + [0.0, 0.0, 1.2]]
    place = Place(arm, big, joint, (along / np.linalg.norm(along)).tolist(), station, float(rng.uniform(0.0, 6.28)))
    if name.startswith(("tracker", "force")):
        return _draw_of_instrument(rng, name, place)
    return _draw_of_robot(rng, name, place, scenario, rows)


def _draw_of_instrument(rng: np.random.Generator, name: str, place: Place) -> Effect:
    if name == "tracker_refraction":
        return Effect(name, None, None, 1e-5, "1/m", {"station_m": place.station}, known=False)
    if name == "tracker_eccentricity":
        params = {"station_m": place.station, "phase_rad": place.phase, "cycles": int(rng.choice([3, 4, 6]))}
        return Effect(name, None, None, 1e-5, "rad", params, known=False)
    if name == "tracker_scale":
        return Effect(name, None, None, 1e-5, "1", {"station_m": place.station}, known=False)
    matrix = rng.normal(size=(3, 3))
    np.fill_diagonal(matrix, 0.0)
    return Effect(name, None, None, 0.02, "1", {"matrix": matrix.tolist()}, known=False)


def _draw_of_robot(rng: np.random.Generator, name: str, place: Place, scenario: Scenario, rows: Rows) -> Effect:
    if name == "hose_pull":
        anchor = [float(v) for v in rng.uniform(-0.4, 0.4, 3) + np.array([0.0, 0.0, 2.0])]
        return Effect(
            name,
            size=100.0,
            unit="N/m",
            params={"anchor_m": anchor, "slack_m": float(rng.uniform(0.4, 1.0))},
            known=False,
        )
    if name == "stick_scatter":
        return Effect(name, place.joint, None, 1e-4, "rad", {"seed": int(rng.integers(2**31))}, known=False)
    if name == "loose_flange":
        return Effect(name, None, None, 1e-4, "rad", {"moment_Nm": float(rng.uniform(15.0, 60.0))}, known=False)
    if name == "creep":
        return Effect(
            name, str(rng.choice(place.big)), None, 0.3, "1", {"tau_s": float(rng.uniform(60.0, 600.0))}, known=False
        )
    if name == "path_vibration":
        params = {"frequency_Hz": float(rng.uniform(0.4, 3.0)), "along": place.along, "phase_rad": place.phase}
        return Effect(name, None, None, 1e-4, "m", params, known=False)
    if name == "load_dependent_backlash":
        chosen = str(rng.choice(place.big))
        load = simulate_rows(scenario, rows).load[:, scenario.own_springs(chosen)[0]]
        torque = float(np.sqrt(np.mean(load**2))) + 1e-6
        return Effect(name, chosen, None, 1e-4, "rad, full width", {"torque_Nm": torque}, known=False)
    if name == "settling_foundation":
        params = {"about": place.along, "seconds": float(rows.time[-1])}
        return Effect(name, None, None, 1e-4, "rad", params, known=False)
    if name == "elastic_cross_coupling":
        k = int(rng.integers(1, len(place.big)))
        bends = place.big[k - 1] if rng.random() < 0.5 else place.arm[3]
        return Effect(name, place.big[k], None, 1e-7, "rad/(N m)", {"bends": bends}, known=False)
    if name == "sun_on_link":
        params = {
            "about": place.along,
            "tau_s": float(rng.uniform(1500.0, 5000.0)),
            "phase_rad": place.phase,
            "sway": float(rng.uniform(0.5, 1.5)),
        }
        return Effect(name, str(rng.choice(place.arm[1:4])), None, 1e-4, "rad", params, known=False)
    return Effect(name, place.joint, None, 1e-4, "rad", {"speed_rad_s": float(rng.uniform(0.003, 0.02))}, known=False)


def _hose_pull(e: Effect, s: Scenario) -> Scenario:
    def load(rows: Rows, p: Array, r: Array) -> Array:
        arm = np.array(e.params["anchor_m"]) - p
        if rows.q.shape[1] > 6:
            arm[:, 1] += rows.q[:, 0]
        length = np.linalg.norm(arm, axis=1)
        pull = e.size * np.maximum(length - e.params["slack_m"], 0.0)
        return np.concatenate([arm * (pull / length)[:, None], np.zeros_like(arm)], axis=1)

    return replace(s, loads=(*s.loads, load))


def _stick_scatter(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        visit = rows.visit
        noise = np.random.default_rng(e.params["seed"] + rows.later).uniform(-1.0, 1.0, int(visit[-1]) + 1)
        q = q.copy()
        moved = np.r_[True, np.abs(np.diff(rows.q[:, j])) > 1e-9]
        value, held = noise[visit], 0.0
        out = np.empty(len(q))
        for k in range(len(q)):
            if moved[k] and not rows.is_path[k]:
                held = value[k]
            out[k] = held
        q[:, j] += e.size * out
        return q

    return replace(s, transmission=(*s.transmission, change))


def _loose_flange(e: Effect, s: Scenario) -> Scenario:
    """The tilt is worked out on the moment about the flange and turns the tool about it."""
    tool = next(seg for seg in s.description.segments if seg.child == "tool")
    tip = np.array(s.description.segments[-1].xyz)
    gravity = np.zeros(3) if s.description.gravity is None else np.array(s.description.gravity)

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        mount = r @ np.linalg.inv(_tip_rotation(s))
        arm = np.einsum("nij,j->ni", mount, tip)
        moment = np.cross(arm, rows.wrench[:, :3]) + rows.wrench[:, 3:]
        moment = moment + np.cross(np.einsum("nij,j->ni", mount, np.array(tool.com)), tool.mass * gravity)
        axis = mount[:, :, 0] if abs(s.description.segments[-1].rpy[1]) > 1.0 else mount[:, :, 2]
        bending = moment - np.einsum("ni,ni->n", moment, axis)[:, None] * axis
        size = np.linalg.norm(bending, axis=1)
        tilt = e.size * np.clip(size / e.params["moment_Nm"], 0.0, 1.0)
        turn = np.array([rotation_step(v) for v in bending * (tilt / np.maximum(size, 1e-9))[:, None]])
        return p + np.einsum("nij,nj->ni", turn, arm) - arm, turn @ r

    return replace(s, instrument=(see, *s.instrument))


def _tip_rotation(s: Scenario) -> Array:
    return rotation_from_rpy(s.description.segments[-1].rpy)


def _sight(e: Effect, p: Array) -> tuple[Array, Array]:
    line = p - np.array(e.params["station_m"])
    return line, np.linalg.norm(line, axis=1)


def _tracker_refraction(e: Effect, s: Scenario) -> Scenario:
    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        line, distance = _sight(e, p)
        out = p.copy()
        out[:, 2] += e.size * (distance**2 + 0.6 * distance * line[:, 2])
        return out, r

    return replace(s, instrument=(*s.instrument, see))


def _tracker_eccentricity(e: Effect, s: Scenario) -> Scenario:
    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        line, _ = _sight(e, p)
        azimuth = np.arctan2(line[:, 1], line[:, 0])
        swing = e.size * np.sin(e.params["cycles"] * azimuth + e.params["phase_rad"])
        out = p.copy()
        out[:, 0] -= swing * line[:, 1]
        out[:, 1] += swing * line[:, 0]
        return out, r

    return replace(s, instrument=(*s.instrument, see))


def _tracker_scale(e: Effect, s: Scenario) -> Scenario:
    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        return p + e.size * _sight(e, p)[0], r

    return replace(s, instrument=(*s.instrument, see))


def _force_cross_talk(e: Effect, s: Scenario) -> Scenario:
    matrix = np.array(e.params["matrix"])

    def sense(rows: Rows, wrench: Array, rotation: Array) -> Array:
        local = np.einsum("nji,nj->ni", rotation, wrench[:, :3])
        out = wrench.copy()
        out[:, :3] += e.size * np.einsum("nij,nj->ni", rotation, local @ matrix.T)
        return out

    return replace(s, sensor=(*s.sensor, sense))


def _creep(e: Effect, s: Scenario) -> Scenario:
    """A Kelvin element in series with the joint's spring: its strain follows size * c * torque with a time constant."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]
    c = s.compliance[k]

    def shift(rows: Rows, load: Array) -> Array:
        delta = np.zeros_like(rows.q)
        target = e.size * c * load[:, k]
        strain = target[0]
        for i in range(len(target)):
            wait = rows.time[i] - rows.time[i - 1] if i else 0.0
            decay = np.exp(-max(wait, 0.0) / e.params["tau_s"])
            strain = target[i] + (strain - target[i]) * decay
            delta[i, j] = strain
        return delta

    return replace(s, after=(*s.after, shift))


def _path_vibration(e: Effect, s: Scenario) -> Scenario:
    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        swing = e.size * np.sin(2.0 * np.pi * e.params["frequency_Hz"] * rows.time + e.params["phase_rad"])
        return p + (rows.is_path * swing)[:, None] * np.array(e.params["along"]), r

    return replace(s, instrument=(*s.instrument, see))


def _load_dependent_backlash(e: Effect, s: Scenario) -> Scenario:
    """Lost motion as wide as the square of the torque says, half of it on either side."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]

    def shift(rows: Rows, load: Array) -> Array:
        side = (play(rows.q[:, j], 1e-4, -0.5) - rows.q[:, j]) / 1e-4
        delta = np.zeros_like(rows.q)
        delta[:, j] = e.size * side * (load[:, k] / e.params["torque_Nm"]) ** 2
        return delta

    return replace(s, after=(*s.after, shift))


def _settling_foundation(e: Effect, s: Scenario) -> Scenario:
    about = np.array(e.params["about"])

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        time = rows.time + (e.params["seconds"] if rows.later else 0.0)
        tilt = e.size * np.sqrt(time / e.params["seconds"])
        turn = np.array([rotation_step(a * about) for a in tilt])
        return np.einsum("nij,nj->ni", turn, p), turn @ r

    return replace(s, instrument=(*s.instrument, see))


def _elastic_cross_coupling(e: Effect, s: Scenario) -> Scenario:
    bends = s.own_springs(e.params["bends"])[0]
    return replace(s, couplings=(*s.couplings, (bends, s.own_springs(str(e.joint))[0], e.size)))


def _sun_on_link(e: Effect, s: Scenario) -> Scenario:
    """The bend turns everything behind the link's joint; it is built as a driven spring about a skew axis."""
    first = len(s.springs)
    for axis in ("rx", "ry", "rz"):
        s = s.add_spring(Spring(str(e.joint), axis, 1e-12))
    about = np.array(e.params["about"])

    def torque(part: float) -> object:
        def drive(rows: Rows) -> Array:
            time = rows.time + (3.0 * e.params["tau_s"] if rows.later else 0.0)
            warm = 1.0 - np.exp(-time / e.params["tau_s"])
            sway = e.params["sway"] * np.sin(time / e.params["tau_s"] + e.params["phase_rad"])
            return np.asarray(e.size * part * (warm + sway) / 1e-12)

        return drive

    extra = tuple((first + i, torque(float(about[i]))) for i in range(3))
    return replace(s, torques=(*s.torques, *extra))  # type: ignore[arg-type]


def _friction_in_path(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        speed = np.zeros(len(q))
        for label in dict.fromkeys(rows.run[rows.is_path].tolist()):
            k = np.flatnonzero(rows.run == label)
            speed[k] = np.gradient(rows.q[k, j], rows.time[k])
        creep = np.abs(speed) / e.params["speed_rad_s"]
        q[:, j] -= e.size * np.sign(speed) * creep * np.exp(1.0 - creep)
        return q

    return replace(s, transmission=(*s.transmission, change))


APPLY_UNKNOWN: dict[str, Apply] = {
    "hose_pull": _hose_pull,
    "stick_scatter": _stick_scatter,
    "loose_flange": _loose_flange,
    "tracker_refraction": _tracker_refraction,
    "tracker_eccentricity": _tracker_eccentricity,
    "tracker_scale": _tracker_scale,
    "force_cross_talk": _force_cross_talk,
    "creep": _creep,
    "path_vibration": _path_vibration,
    "load_dependent_backlash": _load_dependent_backlash,
    "settling_foundation": _settling_foundation,
    "elastic_cross_coupling": _elastic_cross_coupling,
    "sun_on_link": _sun_on_link,
    "friction_in_path": _friction_in_path,
}
