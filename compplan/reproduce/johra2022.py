"""Johra et al. 2022: an elasto-geometrical model with a sideways spring, and its use in a control loop (TX200)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from compplan.io.display import Curve, Curves
from compplan.io.palette import CATEGORIES
from compplan.reporting.page import Picture
from compplan.reproduce.correction_loop import LITERAL, WITHOUT_DERIVATIVE, fitted_loop, largest_pole, simulate_loops
from compplan.reproduce.paper import (
    Reproduction,
    Row,
    cannot,
    compare,
    describe_paper,
    draw_figure,
    recompute,
    statement,
    unavailable,
)
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, jacobian, locate_frames
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.ik import build_arm, name_configuration, solve_branches

#: Joint positions at the centre of the part [deg], and that centre [m].
CENTRE_DEG, CENTRE = (0.0, 49.7, 89.3, 0.0, 41.0, 0.0), np.array([1.5, 0.0, 0.183])
FIG_7_DEG, FIG_7_FORCE = (0.0, 90.0, 0.0, 0.0, 0.0, 0.0), 1400.0
#: Table A1 and A2: posture [deg], direction of the force, and the springs that each step identifies.
STEPS = (
    ((0, 90, 0, 0, 0, 0), (0, 1, 0), ("joint_1", "joint_3.rx")),
    ((0, 0, 90, 0, 0, 0), (1, 0, 0), ("joint_2",)),
    ((0, 0, 90, 0, 90, 0), (0, 0, 1), ("joint_3",)),
    ((0, 90, 0, 0, 90, 0), (1, 0, 0), ("joint_5",)),
    ((0, 0, 135, 0, 90, 0), (0, 1, 0), ("joint_4",)),
)
AXIAL_N, LATERAL_N = 1200.0, 500.0
ONE_SPRING = "one spring a joint: Table 1 without the sideways spring and without the 400 mm shift (not stated)"
SHIFT = "shift of the elbow spring taken along +y of joint 3 (sign not stated)"
TOOL = "tool length derived from the stated height of 0.183 m (not stated)"


def reproduce(load: Callable[[str], Robot]) -> Reproduction:
    """Reproduce the paper."""
    robot = load("staubli_tx200")
    single = without_side_spring(robot)
    lateral = error_over_direction(robot)
    rows = [
        *_rows_of_geometry(robot),
        *_rows_of_side_spring(robot, single),
        *_rows_of_steps(robot),
        *_rows_of_grid(robot, single),
        *_rows_of_forming(lateral),
        *_rows_of_loop(),
    ]
    sideways = displace(robot, FIG_7_DEG, [0, FIG_7_FORCE, 0])
    return Reproduction(
        **describe_paper("johra2022"),
        robots=(robot,),
        lede=(
            f"A sideways force of {FIG_7_FORCE:.0f} N moves the tool {abs(sideways[0]) * 1e3:.2f} mm along x only with "
            "the extra elbow spring, as the paper found. Its control law taken literally is unstable; without the "
            "derivative part, or with a plant that fits its gains, it is stable."
        ),
        rows=tuple(rows),
        figures=tuple(_figures(robot, single, lateral)),
    )


def without_side_spring(robot: Robot) -> Robot:
    """Build the model with one spring per joint: no sideways spring, no shifted origin."""
    own = tuple(replace(s, offset=np.zeros(3)) for s in robot.springs if s.axis == "own")
    return replace(robot, name=f"{robot.name}, one spring a joint", springs=own)


def displace(robot: Robot, q_deg: tuple[float, ...], force: list[float] | Array) -> Array:
    """Compute the displacement of the TCP at a posture under a force, or under each of n. Shape (3,) or (n, 3). [m]"""
    chain, wrench = build_chain(robot), np.pad(np.atleast_2d(force), ((0, 0), (0, 3)))
    q = np.tile(np.radians(q_deg), (len(wrench), 1))
    moved = solve_equilibrium(chain, q, wrench).position - solve_equilibrium(chain, q).position
    return moved.reshape(np.shape(force))


def error_over_direction(robot: Robot) -> Array:
    """Compute the deflection at the part's centre over the direction of the lateral force: angle [rad] and size [m]."""
    angle = np.linspace(0, 2 * np.pi, 73)
    force = np.column_stack([LATERAL_N * np.cos(angle), LATERAL_N * np.sin(angle), np.full(73, AXIAL_N)])
    return np.column_stack([angle, np.linalg.norm(displace(robot, CENTRE_DEG, force), axis=1)])


def grid_postures(robot: Robot) -> Array:
    """Solve postures on a 0.6 m grid of about 200 points around the part, tool down. Shape (n, 6). [rad]"""
    arm, steps = build_arm(robot), np.linspace(-0.3, 0.3, 14)
    x, y = (values.ravel() for values in np.meshgrid(CENTRE[0] + steps, steps))
    turn = np.tile(np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]), (x.size, 1, 1))
    slots = solve_branches(arm, np.column_stack([x, y, np.full(x.size, 0.1)]), turn)
    q = slots[:, int(name_configuration(arm, np.radians([CENTRE_DEG]))[0])]
    return np.asarray(q[np.isfinite(q).all(axis=1)])


def load_shares(robot: Robot, q_deg: tuple[float, ...], direction: tuple[float, ...]) -> dict[str, float]:
    """Compute the share of each spring in the deflection along a force."""
    chain = build_chain(robot)
    frames = locate_frames(chain, np.radians([q_deg]))
    lever = jacobian(chain, frames)[0, :3, chain.spring_elements]
    share = np.diag(chain.compliance) * (lever @ np.array(direction, float)) ** 2
    return dict(zip(chain.spring_names, (share / share.sum()).tolist(), strict=True))


def _rows_of_geometry(robot: Robot) -> list[Row]:
    frames = locate_frames(build_chain(robot), np.radians([CENTRE_DEG]))
    position, pointing = frames.tcp_position[0], frames.tcp_rotation[0, :, 2]
    off = float(np.degrees(np.arccos(np.clip(-pointing[2], -1, 1))))
    return [
        compare("x of the tool at the stated joint positions", CENTRE[0], position[0], "m", TOOL),
        compare("z of the tool at the stated joint positions", CENTRE[2], position[2], "m", TOOL, fitted=True),
        statement("The tool stands upright there", "vertical", f"{off:.2f} deg off the vertical", off < 0.1, TOOL),
    ]


def _rows_of_side_spring(robot: Robot, single: Robot) -> list[Row]:
    moved, plain = (displace(r, FIG_7_DEG, [0, FIG_7_FORCE, 0]) * 1e3 for r in (robot, single))
    unshifted = replace(robot, springs=tuple(replace(s, offset=np.zeros(3)) for s in robot.springs))
    flat = displace(unshifted, FIG_7_DEG, [0, FIG_7_FORCE, 0]) * 1e3
    return [
        statement(
            "Fig. 8: displacement along x under a force along y",
            "significant; only with the extra spring and the 400 mm shift",
            f"{moved[0]:.3f} mm with both, {flat[0]:.3f} without the shift, {plain[0]:.3f} with one spring a joint",
            bool(abs(moved[0]) > 0.1 > 10 * abs(plain[0])),
            f"{SHIFT}; at the tool tip",
        ),
        statement(
            "Fig. 9: displacement along y is larger than one spring a joint makes",
            "not in proportion to the distance from the base",
            f"{moved[1]:.2f} mm against {plain[1]:.2f} mm",
            bool(moved[1] > 1.1 * plain[1]),
            f"{SHIFT}; {ONE_SPRING}; values stand in figures only",
        ),
    ]


def _rows_of_steps(robot: Robot) -> list[Row]:
    rows = []
    for number, (q_deg, direction, springs) in enumerate(STEPS, start=1):
        shares = load_shares(robot, q_deg, direction)
        own = sum(shares[name] for name in springs)
        others = max((name for name in shares if name not in springs), key=lambda name: shares[name])
        title = f"Step {number} of the calibration: share of {' and '.join(springs)} in the deflection along the force"
        said = f"{own:.0%}, next {others} with {shares[others]:.0%}"
        note = f"force at the tool tip (the paper pulls at the flange); {TOOL}"
        rows.append(Row(title, "loads as few joints as can be", said, "", None, "trend only", note))
    return rows


def _rows_of_grid(robot: Robot, single: Robot) -> list[Row]:
    q = grid_postures(robot)
    rows = []
    for load, stated in ((600.0, 0.18), (1100.0, 0.34)):
        wrench = np.array([0, 0, -load, 0, 0, 0])
        ends = [solve_equilibrium(build_chain(r), q, wrench).position[:, 2] for r in (robot, single)]
        gap = np.abs(ends[0] - ends[1]) * 1e3
        note = f"{ONE_SPRING}; the paper's number is against measurement, ours between the models; {SHIFT}"
        title = f"Figs. 10 to 13: one spring a joint against the enhanced model, {load:.0f} N, largest dz"
        missing = "the stiffness set of the one-spring model"
        rows.append(compare(title, stated, float(gap.max()), "mm", note, missing=missing))
    rows.append(
        unavailable("Figs. 11b, 13b: enhanced model against measurement, 600 and 1100 N", "0.08 and 0.16 mm",
                    "the measurement")
    )  # fmt: skip
    return rows


def _rows_of_forming(lateral: Array) -> list[Row]:
    low, high = lateral[:, 1].min() * 1e3, lateral[:, 1].max() * 1e3
    left, slope = 1.13 / 3.84, 1e3 / np.hypot(AXIAL_N, LATERAL_N)  # [1, 1/kN]
    inside = "order of magnitude" if low <= 3.84 <= high else cannot("the force history")
    loads = f"{AXIAL_N:.0f} N along z and {LATERAL_N:.0f} N sideways in every direction"
    return [
        Row("Largest uncorrected error in forming", 3.84, f"{low:.2f} to {high:.2f}", "mm", None, inside,
            f"{loads}, at the part's centre; {TOOL}"),
        recompute("Improvement by the correction", 70.0, 100 * (1 - left), "%", "1 - 1.13 / 3.84, both the paper's"),
        Row("Fig. 19: error norm over the force norm", "grows without correction, stays below a threshold with it",
            f"{low * slope:.2f} to {high * slope:.2f} mm/kN without it, proportional to the force; with it {left:.0%} "
            "of that", "", None, "trend only",
            f"{loads}, scaled; {TOOL}"),
        Row("Error left after the correction", 1.13,
            f"{left:.0%} of the deflection, which is the effective error of the model", "mm", None,
            cannot("the force history and the true stiffness"),
            "with C the true and C' the modelled compliance the loop leaves (C - C') w: none for a perfect model"),
    ]  # fmt: skip


def _rows_of_loop() -> list[Row]:
    fitted = fitted_loop()
    plant = fitted.plant
    literal, pi, pole = (largest_pole(loop) for loop in (LITERAL, WITHOUT_DERIVATIVE, fitted))
    note = f"Kc {LITERAL.gain:g}, Ti {LITERAL.integral:g} s, Td {LITERAL.derivative:g} s at 100 Hz"
    return [
        Row("PID loop taken literally: largest pole", "stable, no overshoot", f"{literal:.2f}", "", None,
            "matches" if literal < 1 else "inconsistent in the paper",
            f"{note}; eqs. (6) to (8) and (17), the correction acts one sample later, the robot follows at once"),
        Row("The same without the derivative part: largest pole", "stable", f"{pi:.2f}", "", None,
            "matches" if pi < 1 else "inconsistent in the paper", note),
        Row("PID loop with a plant that fits the gains: largest pole", "stable", f"{pole:.3f}", "", None,
            "fitted" if pole < 1 else cannot("the dynamics of the plant"),
            f"{note}; plant of {plant.lag * 1e3:.1f} ms lag and {plant.delay * 1e3:.0f} ms delay, from the rule of "
            "Ziegler and Nichols read backwards (Ti = 4 Td)"),
    ]  # fmt: skip


def _figures(robot: Robot, single: Robot, lateral: Array) -> list[Picture]:
    forces = np.linspace(0, FIG_7_FORCE, 8)
    moved, plain = (displace(r, FIG_7_DEG, np.outer(forces, [0, 1, 0])) * 1e3 for r in (robot, single))
    lines = tuple(
        Curve(f"{axis}, {name}", forces, values[:, k], k + dashed, "lines+markers")
        for k, axis in ((0, "x"), (1, "y"))
        for name, values, dashed in (("enhanced", moved, 0), ("one spring a joint", plain, len(CATEGORIES)))
    )
    time, responses = simulate_loops()
    q = grid_postures(robot)
    compliance = cartesian_compliance(build_chain(robot), q)
    x = locate_frames(build_chain(robot), q).tcp_position[:, 0]
    diagonal = tuple(Curve(f"along {'xyz'[k]}", x, compliance[:, k, k] * 1e6, k, "markers") for k in range(3))
    errors = (Curve("enhanced model", np.degrees(lateral[:, 0]), lateral[:, 1] * 1e3, 0),)
    loops = tuple(Curve(name, time, np.clip(v, -1.5, 1.5), k) for k, (name, v) in enumerate(responses.items()))
    return [
        draw_figure("Figs. 8 and 9: posture of Fig. 7 under a force along y",
                    Curves("", "force [N]", "displacement [mm]", lines),
                    "At the tool tip. Only the extra spring, shifted 400 mm, moves the tool along x."),
        draw_figure("Compliance over the work area", Curves("", "x [m]", "compliance [µm/N]", diagonal),
                    "Tool down, z = 0.1 m. Lateral compliance depends on the one digit of k5 and on the tool length."),
        draw_figure("Error before correction over the direction of the lateral force",
                    Curves("", "direction of the lateral force [deg]", "deflection [mm]", errors,
                           (3.84, "largest measured in the paper")),
                    f"At the part's centre, {AXIAL_N:.0f} N along z and {LATERAL_N:.0f} N sideways."),
        draw_figure("Response of the control loop", Curves("", "time [s]", "remaining error [mm]", loops),
                    "After a load of 1 mm deflection. The literal law grows without bound (clipped); without "
                    "derivative, or with a fitting plant, the error dies away."),
    ]  # fmt: skip
