"""The nonlinear program of a compensated path: commanded joint positions whose loaded tool stands on the nominal path.

Variables are the commanded joint positions at every waypoint (and slacks where there are any):

    minimise    sum w (|q''|^2 + |q - q_start|^2 / l^4)      smooth, and near the posture that was chosen
                (or (q - q_start)'' where q_start is a motion that was chosen for a reason)
    subject to  p(q) = p_nominal,  b1 . z(q) = b2 . z(q) = 0   loaded tip on the path, tool axis right
                b3 . x(q) = 0                                  where the rotation about the tool axis is not free
                q_min <= q <= q_max,  |p_unloaded(q) - p_nominal| <= c
                |q_{i+1} - q_i| <= v_max dt + s,  |acceleration| <= a_max + s

The loaded pose is the unloaded one (CasADi kinematics) with a deflection that is exact at the point of linearisation
and carries its exact first derivative: p(q) = p_r(q) + R_r(q) (d + D (q - q_0)). Solving, linearising again at the
solution and solving again is Newton's method on the exact equilibrium, and costs the same for six springs as for forty.
w weighs the joints by what their motion costs in accuracy at the tip; a rail keeps q_start. Rows that cannot become
active are left out; `ProgramRows` says which are in. The Hessian is that of the objective
(Gauss-Newton).
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compplan.plan.path_problem import (
    PathProblem,
    ProgramRows,
    bound_axes,
    pose_data,
    rate_matrix,
    smoothness_matrix,
)
from compplan.robot import Array
from compplan.statics.chain import Chain
from compplan.statics.kinematics import build_pose_function
from compplan.statics.sensitivity import AttainedPose

LOG = logging.getLogger(__name__)

#: Weight of a missed pose equation of a released waypoint; any, for its joint positions are given.
RELEASE_WEIGHT = 1e-6
#: Weight of a missed rate row.
RATE_WEIGHT = 1e-3

IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-8,
    "constr_viol_tol": 1e-8,
    "acceptable_tol": 1e-8,
    "acceptable_constr_viol_tol": 1e-8,
    "max_iter": 40,
    "bound_relax_factor": 0.0,
    "bound_push": 1e-6,
    "bound_frac": 1e-6,
    "slack_bound_push": 1e-6,
    "slack_bound_frac": 1e-6,
    "mu_init": 1e-4,
    "nlp_scaling_method": "none",
    "linear_solver": "mumps",
}


@dataclass(frozen=True)
class Nlp:
    """The program, ready to be solved or looked at.

    Attributes:
        problem: What it was made from.
        rows: Which rows it has.
        solver: CasADi's solver; `solver.stats()` tells about its last run.
        constraints: Function (x, p) -> g, for inspection.
        lower_g: Lower bounds of the constraints.
        upper_g: Upper bounds of the constraints.
        extra: Number of slack variables after the joint positions.

    """

    problem: PathProblem
    rows: ProgramRows
    solver: ca.Function
    constraints: ca.Function
    lower_g: Array
    upper_g: Array
    extra: int


class NlpSolution(NamedTuple):
    """What the solver answers, success or not.

    Attributes:
        q: Joint positions. Shape (n, nq). [rad or m]
        success: Whether the solver says that they fulfil the program.
        status: The solver's own word.
        iterations: Its iterations.
        time: Wall time in the solver. [s]
        violation: Greatest violation of the constraints. [m or rad]
        residual: Missed pose equations of the released waypoints. Shape (r, equations). [m, rad]
        excess: Missed rate rows, velocity before acceleration. Shape (v + a,). [rad or m, rad/s or m/s]

    """

    q: Array
    success: bool
    status: str
    iterations: int
    time: float
    violation: float
    residual: Array
    excess: Array


def build_nlp(problem: PathProblem, rows: ProgramRows) -> Nlp:
    """Build the program of a path.

    Args:
        problem: What the path has to fulfil.
        rows: Which rows beside the pose equations are in the program.

    Returns:
        The program; `solve_nlp` solves it around any point of linearisation.

    """
    n, nq = problem.q_start.shape
    rates, bound = rate_matrix(problem, rows)
    smooth = smoothness_matrix(problem)
    misses = len(rows.released) * problem.equations
    joints, slack = ca.MX.sym("q", nq * n), ca.MX.sym("slack", misses + len(bound))
    data, start = ca.MX.sym("data", _pose_residual(problem).size1_in(1), n), ca.MX.sym("start", nq, n)
    limit = ca.MX.sym("limit", 1 if len(rows.limited) else 0)
    x, p = ca.vertcat(joints, slack), ca.vertcat(ca.vec(data), ca.vec(start), limit)
    square = ca.reshape(joints, nq, n)
    parts = [_pose_rows(problem, rows, square, slack, data)]
    if len(rows.limited):
        parts.append(_correction_rows(problem, rows, square, slack, data, limit))
    if len(bound):
        parts.append(_rate_rows(rates, bound, joints, slack, misses))
    g, jacobian = ca.vertcat(*(part.value for part in parts)), ca.vertcat(*(part.derivative for part in parts))
    bent = square - start if problem.keeps_shape else square
    worth = ca.DM(problem.worth)
    objective = ca.dot(worth, ca.sum2(ca.mtimes(bent, ca.DM(smooth.T)) ** 2))
    objective += ca.dot(ca.DM(problem.anchor).T, ca.mtimes(worth.T, (square - start) ** 2))
    objective += RELEASE_WEIGHT * ca.sumsqr(slack[:misses]) + RATE_WEIGHT * ca.sum1(slack[misses:])
    options: dict[str, Any] = {
        "hess_lag": _objective_hessian(problem, smooth, misses, len(bound), x, p, g.numel()),
        "jac_g": ca.Function("jacobian", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "calc_lam_p": False,
        "no_nlp_grad": True,
        "print_time": False,
        "ipopt": IPOPT,
    }
    solver = ca.nlpsol("path", "ipopt", {"x": x, "f": objective, "g": g, "p": p}, options)
    inspect = ca.Function("constraints", [x, p], [g], ["x", "p"], ["g"])
    lower, upper = (np.concatenate([getattr(part, side) for part in parts]) for side in ("lower", "upper"))
    return Nlp(problem, rows, solver, inspect, lower, upper, slack.numel())


def solve_nlp(nlp: Nlp, q: Array, attained: AttainedPose, *, bounded: NDArray[np.bool_] | None = None) -> NlpSolution:
    """Solve the program around a point of linearisation.

    Args:
        nlp: The program.
        q: Where the deflections are linearised, and where the solver starts. Shape (n, nq). [rad or m]
        attained: Loaded pose and its derivative there.
        bounded: Joint positions that are bounded, in place of those of the rows. Shape (n, nq).

    """
    problem, rows = nlp.problem, nlp.rows
    n, nq = q.shape
    mask = rows.bounded if bounded is None else bounded
    lower, upper = (np.where(mask, limit, sign * np.inf) for limit, sign in ((problem.lower, -1), (problem.upper, 1)))
    lower[:, problem.stays] = upper[:, problem.stays] = problem.q_start[:, problem.stays]
    lower[rows.released] = upper[rows.released] = q[rows.released]
    misses = len(rows.released) * problem.equations
    slack_lower = np.r_[np.full(misses, -np.inf), np.zeros(nlp.extra - misses)]
    limit = [problem.max_correction] if len(rows.limited) else []
    parameters = np.r_[pose_data(problem, q, attained).ravel(), problem.q_start.ravel(), limit]
    clock = time.perf_counter()
    answer = nlp.solver(
        x0=np.r_[np.clip(q, lower, upper).ravel(), np.zeros(nlp.extra)],
        p=parameters,
        lbx=np.r_[lower.ravel(), slack_lower],
        ubx=np.r_[upper.ravel(), np.full(nlp.extra, np.inf)],
        lbg=nlp.lower_g,
        ubg=nlp.upper_g,
    )
    spent = time.perf_counter() - clock
    x, g, stats = np.array(answer["x"])[:, 0], np.array(answer["g"])[:, 0], nlp.solver.stats()
    violation = float(np.maximum(nlp.lower_g - g, g - nlp.upper_g).max(initial=0.0))
    good = bool(stats["success"]) and violation < 1e-7
    residual = x[n * nq : n * nq + misses].reshape(-1, problem.equations)
    solved = np.clip(x[: n * nq].reshape(n, nq), lower, upper)
    status, iterations = str(stats["return_status"]), int(stats["iter_count"])
    LOG.debug("nonlinear program: %s, %d iterations, %.2f s, violation %.1g", status, iterations, spent, violation)
    return NlpSolution(solved, good, status, iterations, spent, violation, residual, x[n * nq + misses :])


class _Part(NamedTuple):
    """Some constraint rows: value, derivative with respect to all variables, bounds."""

    value: ca.MX
    derivative: ca.MX
    lower: Array
    upper: Array


def _pose_rows(problem: PathProblem, rows: ProgramRows, joints: ca.MX, slack: ca.MX, data: ca.MX) -> _Part:
    """Build the pose equations of every waypoint, less what released waypoints miss."""
    nq, n, size = *joints.shape, problem.equations
    residual = _pose_residual(problem)
    value = ca.vec(residual.map(n)(joints, data))
    columns = ca.vec(_differentiate(residual).map(n)(joints, data))
    derivative = ca.MX(_block_pattern(np.arange(n) * size, size, nq, n), columns)
    places = (rows.released[:, None] * size + np.arange(size)).ravel()
    missed = sparse.csc_matrix(
        (-np.ones(len(places)), (places, np.arange(len(places)))), shape=(n * size, slack.numel())
    )
    zeros = np.zeros(n * size)
    return _Part(value + ca.mtimes(ca.DM(missed), slack), ca.horzcat(derivative, ca.DM(missed)), zeros, zeros)


def _correction_rows(
    problem: PathProblem, rows: ProgramRows, joints: ca.MX, slack: ca.MX, data: ca.MX, limit: ca.MX
) -> _Part:
    """Build the correction limit at some waypoints."""
    nq, n = joints.shape
    count, chosen = len(rows.limited), rows.limited.tolist()
    arguments = joints[:, chosen], data[nq : nq + 3, chosen], limit
    function = _correction(problem.chain)
    value = ca.vec(function.map(count)(*arguments))
    columns = ca.vec(_differentiate(function).map(count)(*arguments))
    pattern = _block_pattern(np.arange(count), 1, nq, n, rows.limited)
    derivative = ca.horzcat(ca.MX(pattern, columns), ca.DM(count, slack.numel()))
    return _Part(value, derivative, np.full(count, -np.inf), np.zeros(count))


def _rate_rows(rates: sparse.csc_matrix, bound: Array, joints: ca.MX, slack: ca.MX, misses: int) -> _Part:
    """Build the velocity and acceleration limits, less their slacks."""
    count = len(bound)
    slacks = sparse.hstack([sparse.csc_matrix((count, misses)), -sparse.identity(count)])
    matrix = ca.DM(sparse.csc_matrix(sparse.vstack([sparse.hstack([rates, slacks]), sparse.hstack([-rates, slacks])])))
    value = ca.mtimes(matrix, ca.vertcat(joints, slack))
    return _Part(value, ca.MX(matrix), np.full(2 * count, -np.inf), np.tile(bound, 2))


def _differentiate(function: ca.Function) -> ca.Function:
    """Build the derivative of a function of one waypoint with respect to its first argument, dense."""
    arguments = [ca.SX.sym(f"a{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    derivative = ca.densify(ca.jacobian(function(*arguments), arguments[0]))
    return ca.Function(f"{function.name()}_rate", arguments, [ca.cse(derivative)])


def _block_pattern(
    first: NDArray[np.int_], height: int, nq: int, n: int, columns: NDArray[np.int_] | None = None
) -> ca.Sparsity:
    """Build the pattern of dense blocks (height, nq), block k in the columns of waypoint k (or columns[k])."""
    starts = np.arange(n) if columns is None else columns
    filled = np.zeros(n, int)
    filled[starts] = height
    pointers = np.r_[0, np.cumsum(np.repeat(filled, nq))]
    rows = np.repeat(first, nq * height) + np.tile(np.arange(height), nq * len(first))
    return ca.Sparsity(height * len(first), n * nq, pointers.tolist(), rows.tolist())


def _pose_residual(problem: PathProblem) -> ca.Function:
    """Build (q, data) -> missed pose equations of one waypoint."""
    nq, pose = problem.chain.nq, build_pose_function(problem.chain)
    q = ca.SX.sym("q", nq)
    names = [("q0", nq), ("position", 3), ("b1", 3), ("b2", 3)] + ([] if problem.spin_free else [("b3", 3)])
    names += [("shift", 3), ("shift_rate", 3 * nq)]
    names += [part for axis in bound_axes(problem) for part in (("xyz"[axis], 3), (f"{'xyz'[axis]}_rate", 3 * nq))]
    data = {name: ca.SX.sym(name, size) for name, size in names}
    position, rotation = pose(q)
    away = q - data["q0"]

    def carried(name: str) -> ca.SX:
        local = data[name] + ca.mtimes(ca.reshape(data[f"{name}_rate"], 3, nq), away)
        return ca.mtimes(rotation, local)

    missed = [position + carried("shift") - data["position"]]
    if not problem.axis_free:
        z = carried("z")
        missed += [ca.dot(data["b1"], z), ca.dot(data["b2"], z)]
    if not problem.spin_free:
        missed.append(ca.dot(data["b3"], carried("x")))
    return ca.Function("pose_residual", [q, ca.vertcat(*data.values())], [ca.vertcat(*missed)])


def _correction(chain: Chain) -> ca.Function:
    """Build (q, wanted position, c) -> (|p_unloaded - wanted|^2 - c^2) / (2 c), which is a length near its bound."""
    q, wanted, limit = ca.SX.sym("q", chain.nq), ca.SX.sym("position", 3), ca.SX.sym("limit")
    gap = build_pose_function(chain)(q)[0] - wanted
    return ca.Function("correction", [q, wanted, limit], [(ca.sumsqr(gap) - limit**2) / (2 * limit)])


def _objective_hessian(
    problem: PathProblem, smooth: sparse.csr_matrix, misses: int, rates: int, x: ca.MX, p: ca.MX, rows: int
) -> ca.Function:
    """Build the constant Hessian of the objective, upper triangle."""
    bend = smooth.T @ smooth + sparse.diags(problem.anchor)
    joints = sparse.kron(bend, sparse.diags(problem.worth))
    slack = sparse.diags(np.r_[np.full(misses, RELEASE_WEIGHT), np.zeros(rates)], shape=(misses + rates,) * 2)
    full = sparse.triu(2.0 * sparse.block_diag([joints, slack])).tocsc()
    full.sort_indices()
    pattern = ca.Sparsity(full.shape[0], full.shape[1], full.indptr.tolist(), full.indices.tolist())
    scale, multipliers = ca.MX.sym("scale"), ca.MX.sym("multipliers", rows)
    names = ["x", "p", "lam_f", "lam_g"]
    value = scale * ca.MX(ca.DM(pattern, full.data))
    return ca.Function("hessian", [x, p, scale, multipliers], [value], names, ["triu_hess_gamma_x_x"])
