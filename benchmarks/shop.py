"""A virtual shop to play the loop with: it runs programs on a robot with hidden errors, and measures.

    python -m benchmarks shop measure POSES/campaign.csv --robot kuka_kr270 --seed 7 --out log.csv    fills in the log
    python -m benchmarks shop cut PLAN --robot kuka_kr270 --seed 7 --out part1.csv         cuts and probes a part
    python -m benchmarks shop reveal --robot kuka_kr270 --seed 7                             what it hides

The robot of a seed is always the same: a MuJoCo model of the folder's arm that hides three effects (every third seed
one that is outside the vocabulary) and everyday errors of every axis, under a process that pushes harder or softer than
predicted, and a little otherwise at every part. Every part is clamped anew. The tracker stands anywhere, and its
target anywhere on the tool (`compplan diagnose --register base,tool`). A shop reads what the controller would read,
joints and loads, and tells what an instrument would tell: a filled log, or points on the part, brought to the robot
base by the part's own datum (`compplan learn --frame base`). A probe does not know how far along the path a point
lies; `--tracked` stands for an instrument that the program triggers, so that points carry their s_mm. A campaign with
sockets is filled in with the joints at which the ball sits, its plates as long as instrument.toml beside it says. The
shop knows the robot folder's tool, not a job's own.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import Array, read_description
from benchmarks.campaigns.effects import Effect, apply_effect
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario, simulate_rows
from benchmarks.coverage.touched import fit_motion, pick_corners
from benchmarks.simulated_robot.cell import Kinematics
from benchmarks.simulated_robot.job import read_job, read_joints

ROOT = Path(__file__).parents[1]
#: Instrument and robot per axis, and of a point measured on a part. [m]
TRACKER, REPEATABILITY, PROBE = 2e-5, 1.5e-5, 1e-5
#: Standard deviation of the force's level, as the product assumes it where nothing is stated; of its level from part
#: to part; and how a part is clamped, shift [m] and turn [rad] per axis.
LEVEL, SCATTER, CLAMPED = 0.15, 0.07, (1e-5, 2e-5)
#: Where the tracker's frame and its target on the tool are, per axis. [m, rad, m]
FRAME, TARGET = (3e-3, 2e-3), 1e-3
#: By how much every joint approaches a touched point. [rad]
APPROACH = float(np.radians(1.5))
#: How far from where it should be a plate of sockets is put up, per axis. [m]
HAND = 3e-3
#: Everyday errors: lengths [m], directions [rad], zeros [rad], gears [rad], own compliances (share).
LENGTH, TURN, ZERO, GEAR, SOFT = 2e-5, 1e-5, 1e-5, 1e-5, 0.04
#: A program whose tip is farther from the path than this is of another robot or tool. [m]
STRANGE = 0.05
LOAD = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


@dataclass(frozen=True)
class VirtualShop:
    """A virtual shop: what its robot hides, its force over the predicted one, and the randomness of its instruments."""

    scenario: Scenario
    seed: int
    hidden: tuple[str, ...]
    force: float
    random: np.random.Generator
    #: Rotation and shift [m] by which a touched part is off the frame that the controller displays.
    part: tuple[Array, Array] = (np.eye(3), np.zeros(3))


def draw_shop(robot: Path, seed: int) -> VirtualShop:
    """Draw a shop: three hidden effects of different kinds; every third shop has one outside the vocabulary."""
    random = np.random.default_rng([20261122, seed])
    scenario = nominal_scenario(read_description(robot))
    joints = scenario.description.joint_names
    makers: dict[str, Callable[[str], Effect]] = {
        "joint_stiffness": lambda j: Effect("joint_stiffness", j, size=float(random.uniform(0.2, 0.6))),
        "joint_offset": lambda j: Effect("joint_offset", j, size=float(random.uniform(-4, 4)) * 1e-4),
        "backlash": lambda j: Effect("backlash", j, size=float(random.uniform(1, 3)) * 1e-4),
        "transmission_error": lambda j: Effect(
            "transmission_error", j, size=float(random.uniform(0.7, 2)) * 1e-4,
            params={"shape": "waves", "waves": [(1.0, float(random.integers(1, 4)), float(random.uniform(0, 6)))]},
        ),
        "link_compliance": lambda j: Effect("link_compliance", j, "rx", size=float(random.uniform(1, 4)) * 1e-7),
    }  # fmt: skip
    outside = seed % 3 == 2
    names = random.choice(list(makers), size=2 if outside else 3, replace=False)
    hidden = []
    for name in names:
        joint = str(random.choice(joints[:3] if name == "link_compliance" else joints[:5]))
        scenario = apply_effect(makers[str(name)](joint), scenario)
        hidden.append(f"{name} {joint}")
    if outside:
        scenario = add_hose(scenario, random)
        hidden.append("hose (outside the vocabulary)")
    force = 1.0 + LEVEL * float(np.random.default_rng([20261122, seed, 1]).standard_normal())
    hidden.append(f"force x {force:.2f}")
    return VirtualShop(
        add_everyday(scenario, np.random.default_rng([20261122, seed, 3])), seed, tuple(hidden), force, random
    )


def add_everyday(scenario: Scenario, random: np.random.Generator) -> Scenario:
    """Make every axis a little wrong: lengths, directions, zeros, gears, compliances."""
    for joint in scenario.description.joint_names:
        shift = np.r_[LENGTH * random.standard_normal(3), TURN * random.standard_normal(3)]
        wave = [(1.0, float(random.integers(1, 120)), float(random.uniform(0, 6)))]
        for effect in (
            Effect("link_geometry", joint, size=1.0, params={"direction": shift.tolist()}),
            Effect("joint_offset", joint, size=float(ZERO * random.standard_normal())),
            Effect("joint_stiffness", joint, size=float(SOFT * random.standard_normal())),
            Effect("transmission_error", joint, size=float(GEAR * abs(random.standard_normal())),
                   params={"shape": "waves", "waves": wave}),
        ):  # fmt: skip
            if effect.name != "joint_stiffness" or scenario.own_springs(joint):
                scenario = apply_effect(effect, scenario)
    return scenario


def add_hose(scenario: Scenario, random: np.random.Generator) -> Scenario:
    """Hang a hose on the tool: it pulls towards a point over the robot, harder the farther the tool is away."""
    anchor = np.array([0.3, 0.0, 2.5]) + 0.3 * random.standard_normal(3)
    stiffness = float(random.uniform(40, 120))

    def pull(rows: Rows, position: Array, rotation: Array) -> Array:
        return np.concatenate([stiffness * (anchor - position), np.zeros((len(position), 3))], axis=1)

    return replace(scenario, loads=(*scenario.loads, pull))


class Cut(NamedTuple):
    """A part that was cut, at its n cut waypoints."""

    tip: Array  #: Where the tip really was, base frame. Shape (n, 3). [m]
    wanted: Array  #: Where the path wants it. Shape (n, 3). [m]
    length: Array  #: Length of the path there, rapid moves included. Shape (n,). [m]

    @property
    def across(self) -> float:
        """Root mean square deviation across the path. [m]."""
        along = np.gradient(self.wanted, axis=0)
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        off = self.tip - self.wanted
        off = off - np.sum(off * along, axis=1, keepdims=True) * along
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    @property
    def whole(self) -> float:
        """Root mean square deviation, along the path too. [m]."""
        return float(np.sqrt(np.mean(np.sum((self.tip - self.wanted) ** 2, axis=1))))


def read_rows(file: Path) -> tuple[list[dict[str, str]], Array, Array]:
    """Read a table of joints and loads; return its rows, joint angles [rad] and wrenches on the tool [N, N m]."""
    with file.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    q = np.radians(np.array([[float(row[f"q{k}_deg"]) for k in range(1, 7)] for row in rows]))
    return rows, q, np.array([[float(row[name]) for name in LOAD] for row in rows])


def move(
    shop: VirtualShop, q: Array, wrench: Array, *, path: bool, measured: np.ndarray | None = None
) -> tuple[Array, Array]:
    """Let the shop's robot go through rows; return where the tip really is, (n, 3) [m], and its axes, (n, 3, 3)."""
    n = len(q)
    run = np.array(["path1" if path else "static1"] * n)
    rows = Rows(run, np.full(n, path), np.arange(n) * 0.05, q, wrench, np.zeros(n))
    seen = simulate_rows(shop.scenario, rows, measured)
    tip = seen.position + REPEATABILITY * shop.random.standard_normal((1 if path else len(seen.position), 3))
    return tip, seen.rotation


def touch_part(shop: VirtualShop, job: Path, folder: Path) -> VirtualShop:
    """Touch three corners of the box of a cut as it is planned, without process force; return the shop with its part.

    The fixture of all parts stands where the touched points fit best.
    """
    arm = read_job(job).arm
    rows, kinematics = read_joints(folder / "joints.csv", arm), Kinematics(arm)
    cut = rows.wanted[rows.move == "cut"]
    corners = pick_corners(cut)
    near = rows.q[rows.move == "cut"][np.linalg.norm(cut - corners[:, None], axis=2).argmin(axis=1)]
    poses = kinematics.tip(near)
    poses[:, :3, 3] = corners
    q, left = kinematics.reach(near, poses)
    if left.max() > 1e-6:
        raise ValueError("a corner of the part is out of reach")
    q = np.repeat(q, 2, axis=0)
    q[0::2] -= APPROACH
    tip, _ = move(shop, q, np.zeros((len(q), 6)), path=False)
    return replace(shop, part=fit_motion(corners, tip[1::2]))


def cut_part(shop: VirtualShop, folder: Path, scatter: float = SCATTER) -> Cut:
    """Cut the program of a plan, the force and the clamping of this part drawn anew.

    Raises:
        ValueError: If the tip ends up far from the path: the plan is of another robot, or has a tool of the job's own.
    """
    rows, q, wrench = read_rows(folder / "joints.csv")
    cutting = np.flatnonzero([row["move"] == "cut" for row in rows])
    path = np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows]) * 1e-3
    own = np.array([row["move"] in ("cut", "rapid") for row in rows])
    step = np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1)
    length = np.cumsum(np.where(own & np.r_[False, own[:-1]], step, 0.0))
    wanted = path[cutting]
    level = shop.force * (1.0 + scatter * float(shop.random.standard_normal()))
    tip, _ = move(shop, q, level * wrench, path=True, measured=cutting)
    tip = (tip - shop.part[1]) @ shop.part[0]
    shift, turn = (size * shop.random.standard_normal(3) for size in CLAMPED)
    tip = tip + shift + np.cross(turn, tip - wanted.mean(axis=0))  # seen from the part's own datum
    if (off := float(np.linalg.norm(tip - wanted, axis=1).max())) > STRANGE:
        raise ValueError(f"the tip is {1e3 * off:.0f} mm off: a plan of another robot, or with a tool of the job's own")
    return Cut(tip, wanted, length[cutting])


def measure_poses(shop: VirtualShop, empty: Path, log: Path) -> int:
    """Fill in an empty log; return the number of measured poses.

    Two rows a pose: where its approach begins, which stays empty, and the pose, approached from there and measured.
    """
    rows, q, wrench = read_rows(empty)
    tip, axes = move(shop, q, wrench, path=False)
    frame = np.random.default_rng([20261122, shop.seed, 4])
    tip = tip + axes @ (TARGET * frame.standard_normal(3))
    turn = Rotation.from_rotvec(FRAME[1] * frame.standard_normal(3)).as_matrix()
    tip = tip @ turn.T + FRAME[0] * frame.standard_normal(3) + TRACKER * shop.random.standard_normal(tip.shape)
    for row, point in list(zip(rows, tip, strict=True))[1::2]:
        row.update({f"{axis}_mm": f"{1e3 * point[k]:.5f}" for k, axis in enumerate("xyz")})
        row["sigma_mm"] = f"{1e3 * TRACKER:g}"
    _write_rows(log, rows)
    return len(rows) // 2


def seat_ball(shop: VirtualShop, empty: Path, log: Path, plate: float) -> int:
    """Fill in an empty log of sockets: the ball of the true robot sits in them, its joints are what is written down.

    A plate of two sockets, `plate` apart [m], is put up by hand near each place that the log asks for.
    """
    rows, q, wrench = read_rows(empty)
    pose = np.arange(1, len(rows), 2)
    labels = np.array([row["contact"] for row in rows])[pose]
    target = TARGET * np.random.default_rng([20261122, shop.seed, 4]).standard_normal(3)

    def see(joints: Array) -> Array:
        still = Rows(np.array(["static1"] * len(joints)), np.zeros(len(joints), bool), np.arange(len(joints)) * 0.05,
                     joints, wrench, np.zeros(len(joints)))  # fmt: skip
        seen = simulate_rows(shop.scenario, still)
        return np.asarray(seen.position + seen.rotation @ target)[pose]

    tip, wanted = see(q), np.zeros((len(pose), 3))
    for name in dict.fromkeys(label.split("/")[0] for label in labels):
        ends = [tip[np.flatnonzero(labels == f"{name}/{side}")[0]] for side in "01"]
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        middle = 0.5 * (ends[0] + ends[1]) + HAND * shop.random.standard_normal(3)
        for side, sign in (("0", -0.5), ("1", 0.5)):
            wanted[labels == f"{name}/{side}"] = middle + sign * plate * way
    wanted = wanted + np.hypot(TRACKER, REPEATABILITY) * shop.random.standard_normal(wanted.shape)
    slopes = np.stack([(see(q + 1e-5 * one) - tip) / 1e-5 for one in np.eye(q.shape[1])], axis=-1)
    for _ in range(6):
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slopes, rcond=1e-3), wanted - see(q))
        q = q + np.repeat(step, 2, axis=0)
    if (left := float(np.linalg.norm(see(q) - wanted, axis=1).max())) > 1e-6:
        raise ValueError(f"the ball stays {1e3 * left:.2g} mm out of its socket")
    for row, joints in zip(rows, q, strict=True):
        row.update({f"q{k + 1}_deg": f"{np.degrees(value):.7f}" for k, value in enumerate(joints)})
    _write_rows(log, rows)
    return len(pose)


def fill_log(shop: VirtualShop, empty: Path, log: Path) -> int:
    """Fill in the empty log of a campaign, whatever is to be measured; return the number of measured poses."""
    head = read_rows(empty)[0][0]
    if "contact" not in head:
        return measure_poses(shop, empty, log)
    lengths = {table["mm"] for table in tomllib.loads(empty.with_name("instrument.toml").read_text())["distance"]}
    return seat_ball(shop, empty, log, 1e-3 * lengths.pop())


def _write_rows(file: Path, rows: list[dict[str, str]]) -> None:
    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def probe_part(shop: VirtualShop, cut: Cut, file: Path, *, tracked: bool = False) -> None:
    """Measure a cut part: points in the frame of the robot base; tracked ones say how far along the path they are."""
    points = cut.tip * 1e3 + 1e3 * PROBE * shop.random.standard_normal(cut.tip.shape)
    table = np.column_stack([points, np.full(len(points), 1e3 * PROBE), 1e3 * cut.length])
    head = ("x_mm", "y_mm", "z_mm", "sigma_mm", "s_mm")[: 5 if tracked else 4]
    lines = [",".join(f"{v:.5f}" for v in row[: len(head)]) for row in table]
    file.write_text("\n".join([",".join(head), *lines]) + "\n", encoding="utf-8")


def main() -> int:
    """Run one command; return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("measure", "cut", "reveal"))
    parser.add_argument("file", type=Path, nargs="?", help="measure: campaign.csv; cut: folder with joints.csv")
    parser.add_argument("--robot", default="kuka_kr270", help="robot folder, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tracked", action="store_true", help="cut: points carry their place along the path")
    parser.add_argument("--out", type=Path)
    words = parser.parse_args()
    folder = Path(words.robot) if Path(words.robot).is_dir() else ROOT / "robots" / words.robot
    shop = draw_shop(folder, words.seed)
    if words.command == "reveal":
        print("\n".join(shop.hidden))
        return 0
    if words.file is None or words.out is None:
        parser.error(f"{words.command} needs what it works on, and --out")
    table = words.file if words.command == "measure" else words.file / "joints.csv"
    try:
        chance = zlib.crc32(table.read_bytes())
        shop = replace(shop, random=np.random.default_rng([20261122, words.seed, 2, chance]))
        if words.command == "measure":
            print(f"{fill_log(shop, words.file, words.out)} poses measured, wrote {words.out}")
        else:
            part = cut_part(shop, words.file)
            probe_part(shop, part, words.out, tracked=words.tracked)
            print(f"{len(part.tip)} points measured, wrote {words.out}; true distance of the tip from the path (hidden"
                  f" from compplan): {1e3 * part.across:.3f} mm rms")  # fmt: skip
    except (OSError, KeyError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
