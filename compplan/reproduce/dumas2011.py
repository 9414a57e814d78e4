"""Dumas et al. 2011: joint stiffness identification of a six-revolute robot in dexterous zones (KUKA KR 240-2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.identification import Estimate, build_structure, estimate_parameters
from compplan.io.display import Curve, Curves
from compplan.measurement.campaign import make_log
from compplan.reporting.maps.pictures import draw_joint_map
from compplan.reporting.page import Picture
from compplan.reproduce.paper import (
    Reproduction,
    Row,
    cannot,
    compare,
    describe_paper,
    draw_figure,
    statement,
    unavailable,
)
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.quality import find_characteristic_length, quality_of_poses
from compplan.statics.stiffness import ComplementaryInfluence, complementary_influence

#: Table I: ranges of theta_2 and theta_3 of the three zones. Shape (2, 2) each. [rad]
ZONES = {
    name: np.radians(box)
    for name, box in {"Z1": ((0, 110), (-245, -170)), "Z2": ((0, 25), (0, 29)), "Z3": ((100, 146), (0, 29))}.items()
}
#: Table II: errors of the joint stiffnesses, joint 1 not determined. [%]
ERRORS_PERCENT = (None, 8.0, 9.0, 2.0, 2.0, 5.0)
TESTS, REPEATS = 23, 60
WEIGHT_N, LEVER_M = (750.0, 1500.0), 0.3
SIGMA_POSITION, SIGMA_ROTATION, SIGMA_WEIGHT_N, SIGMA_JOINT = 0.03e-3, 1e-4, 0.1 * 9.81, np.radians(0.01)
SIMULATION = (
    f"{TESTS} simulated tests in the zones, weights of {WEIGHT_N[0]:.0f} to {WEIGHT_N[1]:.0f} N hung {LEVER_M:g} m off "
    f"the flange; stated uncertainties taken as standard deviations, rotations {SIGMA_ROTATION:g} rad"
)
MASS_KG = 240.0
WRIST = "wrist joints at 45 deg, joint 1 at zero (stated); characteristic length optimised (not stated)"


@dataclass(frozen=True)
class DexterityMap:
    """Inverse condition number over joints two and three, wrist at 45 deg."""

    q: Array  #: Joint positions. Shape (b, a, 6). [rad]
    inverse_condition: Array  #: 1/kappa_F. Shape (b, a).
    length: float  #: Characteristic length. [m]

    @property
    def joints(self) -> dict[str, Array]:
        """Positions of both joints. Shapes (a,) and (b,). [rad]"""
        return {"theta_2": self.q[0, :, 1], "theta_3": self.q[:, 0, 2]}

    def find_inside(self, box: Array) -> NDArray[np.bool_]:
        """Return which positions lie in a zone. Shape (b, a)."""
        return np.asarray(((self.q[..., 1:3] >= box[:, 0]) & (self.q[..., 1:3] <= box[:, 1])).all(axis=-1))


@dataclass(frozen=True)
class Tests:
    """Simulated tests: postures, and weights at a lever from the flange."""

    q: Array
    wrench: Array


def reproduce(load: Callable[[str], Robot]) -> Reproduction:
    """Reproduce the paper."""
    robot = load("kuka_kr240")
    chain = build_chain(robot)
    quality = map_quality(robot, chain)
    weight = np.array([0.0, 0.0, -9.81 * MASS_KG, 0.0, 0.0, 0.0])
    influence = complementary_influence(chain, quality.q.reshape(-1, robot.nq), weight)
    spread = monte_carlo(robot)
    rows = [
        *_rows_of_zones(robot, quality),
        *_rows_of_influence(influence),
        *_rows_of_identification(robot, spread),
    ]
    inside, outside = mean_inside(quality)
    return Reproduction(
        **describe_paper("dumas2011"),
        robots=(robot,),
        lede=(
            f"The dexterous zones are there: the inverse condition number is {min(inside.values()):.2f} to "
            f"{max(inside.values()):.2f} on average inside Table I's zones, {outside:.2f} outside. K_C is negligible, "
            "joint 1 cannot be determined under vertical loads, and the other errors have the right order."
        ),
        rows=tuple(rows),
        figures=tuple(_figures(robot, quality, influence)),
    )


def mean_inside(quality: DexterityMap) -> tuple[dict[str, float], float]:
    """Average the inverse condition number inside each zone, and outside all of them."""
    inside = {name: quality.find_inside(box) for name, box in ZONES.items()}
    outside = ~np.logical_or.reduce(list(inside.values()))
    means = {name: float(quality.inverse_condition[mask].mean()) for name, mask in inside.items()}
    return means, float(quality.inverse_condition[outside].mean())


def map_quality(robot: Robot, chain: Chain) -> DexterityMap:
    """Compute the inverse condition number over joints two and three, wrist at 45 deg."""
    sides = [np.linspace(robot.lower[j], robot.upper[j], count) for j, count in ((1, 147), (2, 275))]
    q = np.tile(np.radians([0.0, 0, 0, 45, 45, 45]), (275, 147, 1))
    q[..., 1], q[..., 2] = np.meshgrid(*sides)
    length = find_characteristic_length(chain, q[::6, ::6].reshape(-1, robot.nq))
    return DexterityMap(q, quality_of_poses(chain, q.reshape(-1, robot.nq), length).reshape(q.shape[:2]), length)


def draw_tests(robot: Robot, count: int, rng: np.random.Generator, *, lever: float = LEVER_M) -> Tests:
    """Sample postures in the zones, and weights on levers in random directions from the flange."""
    q = np.empty((count, robot.nq))
    picked = np.array(list(ZONES.values()))[rng.integers(len(ZONES), size=count)]
    q[:, 0] = rng.uniform(-np.pi / 2, np.pi / 2, count)
    q[:, 1:3] = rng.uniform(picked[:, :, 0], picked[:, :, 1])
    q[:, 3:] = np.radians(rng.uniform(30, 150, (count, 3)) * rng.choice([-1, 1], (count, 3)))
    q = np.clip(q, robot.lower, robot.upper)
    force = np.zeros((count, 3))
    force[:, 2] = -rng.uniform(*WEIGHT_N, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    across = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)]) * lever
    offset = np.einsum("nij,nj->ni", locate_frames(build_chain(robot), q).tcp_rotation, across)
    return Tests(q, np.hstack([force, np.cross(offset, force)]))


def identify(robot: Robot, tests: Tests, rng: np.random.Generator | None = None) -> Estimate:
    """Identify joint compliances from loaded minus unloaded poses, with measurement errors if rng is given."""
    chain, n = build_chain(robot), len(tests.q)
    noise = np.zeros((5, n, 6)) if rng is None else rng.normal(size=(5, n, 6))
    true_q = tests.q + SIGMA_JOINT * noise[4]
    loaded, bare = solve_equilibrium(chain, true_q, tests.wrench), solve_equilibrium(chain, true_q, np.zeros(6))
    turn = Rotation.from_rotvec(np.sqrt(2) * SIGMA_ROTATION * noise[0, :, :3]).as_matrix()
    shift = np.sqrt(2) * SIGMA_POSITION * noise[1, :, :3]
    nominal = locate_frames(chain, tests.q)
    relative = loaded.rotation @ np.swapaxes(bare.rotation, 1, 2)
    scale = 1 + SIGMA_WEIGHT_N * noise[2, :, :1] / np.abs(tests.wrench[:, 2:3])
    log = make_log(
        tests.q,
        tests.wrench * scale,
        nominal.tcp_position + loaded.position - bare.position + shift,
        turn @ relative @ nominal.tcp_rotation,
        sigma=np.full(n, np.sqrt(2) * SIGMA_POSITION),
        sigma_rotation=np.full(n, np.sqrt(2) * SIGMA_ROTATION),
    )
    return estimate_parameters(build_structure(robot), log, sigma="stated")


def monte_carlo(robot: Robot, repeats: int = REPEATS, seed: int = 0) -> Array:
    """Repeat the identification with new tests and errors: identified compliances, shape (repeats, 6)."""
    rng = np.random.default_rng(seed)
    return np.array([identify(robot, draw_tests(robot, TESTS, rng), rng).model_values for _ in range(repeats)])


def _rows_of_zones(robot: Robot, quality: DexterityMap) -> list[Row]:
    inside, outside = mean_inside(quality)
    rows = []
    for name, mean in inside.items():
        said = f"mean 1/kappa {mean:.3f} inside, {outside:.3f} outside all zones ({mean / outside:.2f} times)"
        rows.append(
            statement(f"Table I: zone {name} is dexterous", "light area of Fig. 2", said, mean > 1.3 * outside, WRIST)
        )
    best = quality.inverse_condition >= np.quantile(quality.inverse_condition, 0.75)
    covered = np.logical_or.reduce([quality.find_inside(box) for box in ZONES.values()])
    share = float((best & covered).sum() / best.sum())
    verdict = "trend only" if share > 0.5 else cannot("the threshold")
    rows.append(Row("Share of the most dexterous quarter that lies in the zones", "zones cover the light areas",
                    f"{share:.0%}", "", None, verdict, WRIST))  # fmt: skip
    row = int(quality.inverse_condition.max(axis=1).argmin())
    highest = float(quality.inverse_condition[row].max())
    rows.append(
        statement("Fig. 2: horizontal singular line, arm folded or stretched", "a line over all theta_2",
                  f"theta_3 = {np.degrees(quality.q[row, 0, 2]):.0f} deg, 1/kappa at most {highest:.4f}",
                  highest < 0.02, WRIST)
    )  # fmt: skip
    folded = robot.joints[3].placement[:3, 3]
    reach = float(np.linalg.norm(robot.joints[1].placement[:2, 3]) + np.linalg.norm(robot.joints[2].placement[:3, 3])
                  + np.linalg.norm(folded))  # fmt: skip
    rows.append(
        compare("Radius of the workspace (wrist centre)", 2.70, reach, "m", "d4 = 1.10 m chosen so", fitted=True)
    )
    return rows


def _rows_of_influence(influence: ComplementaryInfluence) -> list[Row]:
    note = f"weight of {MASS_KG:.0f} kg at the flange (wrench and tool centre point not stated); {WRIST}"
    nu_p, nu_r = float(influence.nu_p.max()), float(np.degrees(influence.nu_r.max()))
    return [
        compare("Fig. 3: largest nu_p", 0.016, nu_p, "", note, missing="the wrench behind the figure"),
        compare("Fig. 3: largest nu_r", 0.025, nu_r, "deg", note, missing="the wrench behind the figure"),
        statement("K_C is negligible", "nu_p and nu_r remain very small in all the joint space",
                  f"nu_p at most {nu_p:.4f}, nu_r at most {nu_r:.1e} deg", nu_p < 0.016 and nu_r < 0.025, note),
    ]  # fmt: skip


def _rows_of_identification(robot: Robot, spread: Array) -> list[Row]:
    rng = np.random.default_rng(1)
    held = identify(robot, draw_tests(robot, TESTS, rng)).held
    said = [item.sentence for item in held if item.held == "joint_1"]
    rows = [
        statement("Table II: stiffness of joint 1 under vertical loads", "can not be determined",
                  said[0] if said else "can be determined", bool(said), SIMULATION)
    ]  # fmt: skip
    through = identify(robot, draw_tests(robot, TESTS, rng, lever=0.0))
    said = [item.sentence for item in through.held if item.held == "joint_6"]
    rows.append(
        statement("Joint 6 where the load passes through its axis", "not as stressed as joints 4 and 5",
                  said[0] if said else "can be determined", bool(said), "weights hung at the flange centre")
    )  # fmt: skip
    for j in range(1, 6):
        stiffness = 1 / spread[:, j]
        rows.append(compare(f"Table II: error of the stiffness of joint {j + 1}", ERRORS_PERCENT[j] or 0.0,
                            float(100 * stiffness.std() / stiffness.mean()), "%", SIMULATION,
                            missing="the uncertainty of the rotations"))  # fmt: skip
    rows.append(Row("Table II: error of joint 2", "1e6 N m/rad (8 %)", f"{1e6 / 6.6e6:.0%}", "", None,
                    "inconsistent in the paper"))  # fmt: skip
    rows.append(unavailable("Displacements over 25 tests, computed against measured", "0.1 mm mean, 0.6 mm largest",
                            "the tests and the measured displacements"))  # fmt: skip
    rows.append(unavailable("Share of links 2 and 3 in the displacement", "at most 21 % and 4.8 %",
                            "the link stiffness and the loads"))  # fmt: skip
    return rows


def _figures(robot: Robot, quality: DexterityMap, influence: ComplementaryInfluence) -> list[Picture]:
    rng, counts = np.random.default_rng(2), np.arange(2.0, TESTS + 1)
    tests = draw_tests(robot, TESTS, rng)
    found = np.array([
        1 / identify(robot, Tests(tests.q[: int(k)], tests.wrench[: int(k)]), np.random.default_rng(3)).model_values[1:]
        for k in counts
    ])  # fmt: skip
    joints, nu_p = quality.joints, influence.nu_p.reshape(quality.inverse_condition.shape)
    lines = tuple(Curve(f"joint {j + 2}", counts, found[:, j], j) for j in range(5))
    settling = Curves("", "number of tests", "identified stiffness [N m/rad]", lines, logarithmic=True)
    return [
        Picture(draw_joint_map(joints, quality.inverse_condition, ZONES, "Inverse condition number 1/κ"),
                f"Wrist at 45 deg, characteristic length {quality.length:.2f} m. The boxes are the paper's zones.",
                "Fig. 2b and Table I"),
        Picture(draw_joint_map(joints, nu_p, ZONES, "nu_p: share of the displacement that K_C changes",
                               high_is_good=False),
                f"Under a weight of {MASS_KG:.0f} kg at the flange; the paper's wrench is not stated.", "Fig. 3a"),
        draw_figure("Fig. 5", settling,
                    "Simulated tests with the paper's uncertainties: the values settle as tests are added."),
    ]  # fmt: skip
