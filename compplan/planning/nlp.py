"""Nonlinear program of a path: one CasADi program over joint positions, and optionally the speed.

    minimise    sum of the costs                       `compplan.planning.costs`
    over        q_i, and x_i (square of the speed), s_i (slack of released stations)
    subject to  rows of every limit within its bounds   `compplan.planning.limits`

The loaded pose is an equality constraint: steps of the fixed point theta <- C (J(q, theta)^T w + tau) from the
equilibrium at the initial guess are part of the expression, so that its derivatives are exact. Every limit and cost is
a function of one station; `Function.map` applies it to all. IPOPT solves with the exact Hessian of the Lagrangian.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compplan.planning.problem import PlanningProblem, Station
from compplan.robot import Array
from compplan.statics.kinematics import build_loaded_function, locate_symbolic

LOG = logging.getLogger(__name__)

SOLVER = "ipopt"
#: Steps of the loaded equilibrium in the expression: each reduces the error of the deflection to about a thousandth on
#: real arms. With the speed as a variable the solution is not a command, and one step suffices.
STEPS, TIMED_STEPS = 3, 1
#: Distance from its bound below which a row is active. [unit of the row]
ACTIVE = 1e-6
#: Pose error above which a released station misses its pose. [m and rad]
MISSED = 1e-7
OPTIONS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-10,
    "acceptable_tol": 1e-7,
    "acceptable_constr_viol_tol": 1e-9,
    "max_iter": 100,
    "bound_relax_factor": 0.0,
    "bound_push": 1e-6,
    "bound_frac": 1e-6,
    "mu_init": 1e-3,
    "nlp_scaling_method": "none",
    "linear_solver": "mumps",
}
#: Options with the speed as a variable: joint positions need not be exact, the dense solution refines them.
TIMED: dict[str, Any] = {"mu_init": 1e-2, "tol": 1e-6, "constr_viol_tol": 1e-8}


class Solution(NamedTuple):
    """Result of the solver, successful or not; k stations."""

    problem: PlanningProblem  #: The problem.
    q: Array  #: Joint positions. Shape (k, nq). [rad or m]
    square: Array  #: Square of the speed as a share of the programmed feed; ones if not a variable. Shape (k,).
    slack: Array  #: Pose error of released stations. Shape (k, rows). [m, rad]
    success: bool  #: Whether the solver succeeded and all limits hold.
    status: str  #: Return status of the solver.
    iterations: int  #: Number of iterations.
    cpu: float  #: CPU time of building and solving. [s]
    violation: float  #: Greatest violation of a row. [m, rad or share]
    multipliers: Mapping[str, Array]  #: Multipliers of the rows of each limit. Shapes (k, r).
    active: Mapping[str, NDArray[np.bool_]]  #: Stations at which each limit is active, by name. Shapes (k,).


class PathProgram(NamedTuple):
    """Program in CasADi."""

    solver: ca.Function  #: CasADi solver; `solver.stats()` describes the last run.
    sizes: tuple[int, ...]  #: Number of rows of each limit at a station.
    #: First variable of q, square and slack in the vector of variables, and their number.
    offsets: tuple[int, int, int, int]


def build_nlp(problem: PlanningProblem) -> PathProgram:
    """Build the program of a problem: variables, objective, constraints."""
    k = len(problem)
    # variables x, and those of each station, v_i = L_i x
    selected, sizes = _selection_matrix(problem)
    x, data = ca.MX.sym("x", selected.shape[1]), ca.MX.sym("data", _pack(problem).shape[1], k)
    local = ca.reshape(ca.mtimes(ca.DM(selected), x), selected.shape[0] // k, k)
    station, inputs = _state_station(problem)
    # objective
    term = sum((each.term(station) for each in problem.costs), ca.SX(0))
    objective = ca.sum2(ca.Function("cost", inputs, [term]).map(k)(local, data))
    # constraints
    parts = [limit.rows(station) for limit in problem.limits]
    rows = ca.vertcat(*parts)
    g = ca.vec(ca.Function("limits", inputs, [rows]).map(k)(local, data))
    # exact derivatives, station by station: J = diag(J_i) L, H = L^T diag(H_i) L
    p, scale, pull = ca.vec(data), ca.MX.sym("scale"), ca.MX.sym("multipliers", g.numel())
    weight, pulls = ca.SX.sym("weight"), ca.SX.sym("pulls", rows.numel())
    slope = ca.Function("slope", inputs, [ca.jacobian(rows, inputs[0])]).map(k)(local, data)
    curvature = ca.hessian(weight * term + ca.dot(pulls, rows), inputs[0])[0]
    curvatures = ca.Function("curvature", [*inputs, weight, pulls], [curvature]).map(k)(
        local, data, ca.repmat(scale, 1, k), ca.reshape(pull, rows.numel(), k))  # fmt: skip
    select = ca.MX(ca.DM(selected))
    jacobian = ca.mtimes(ca.diagcat(*ca.horzsplit(slope, inputs[0].numel())), select)
    hessian = ca.triu(ca.mtimes(select.T, ca.mtimes(ca.diagcat(*ca.horzsplit(curvatures, inputs[0].numel())), select)))
    options: dict[str, Any] = {
        "ipopt": OPTIONS | (TIMED if problem.timed else {}),
        "jac_g": ca.Function("jacobian", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hessian", [x, p, scale, pull], [hessian], ["x", "p", "lam_f", "lam_g"],
                                ["triu_hess_gamma_x_x"]),
        "print_time": False, "calc_lam_p": False, "no_nlp_grad": True,
    }  # fmt: skip
    program: dict[str, Any] = {"x": x, "f": objective, "g": g, "p": p}
    solver = ca.nlpsol("path", SOLVER, program, options)
    return PathProgram(solver, tuple(part.numel() for part in parts), (*np.cumsum([0, *sizes]).tolist(),))


def _selection_matrix(problem: PlanningProblem) -> tuple[sparse.csc_matrix, tuple[int, int, int]]:
    """Build the matrix that selects the variables of each station, and count those of q, square and slack."""
    k, nq, rows = len(problem), problem.chain.nq, problem.pose_rows + 1
    sizes = nq * k, k if problem.timed else 0, rows * k if problem.released is not None else 0
    offsets = np.cumsum([0, *sizes])

    def expand(matrix: Any, kind: int, height: int) -> sparse.csr_matrix:
        """Expand a matrix over stations (k, k) to `height` entries each, in the columns of its kind."""
        part = sparse.kron(matrix, sparse.identity(height))
        before, after = offsets[kind], offsets[-1] - offsets[kind + 1]
        return sparse.hstack([sparse.csr_matrix((k * height, before)), part, sparse.csr_matrix((k * height, after))])

    later = np.minimum(np.arange(k) + 1, k - 1)
    own, ahead = sparse.identity(k), sparse.csr_matrix((np.ones(k), (np.arange(k), later)))
    parts = [(expand(own, 0, nq), nq), (expand(ahead, 0, nq), nq)]
    if problem.timed:
        half = sparse.diags(np.divide(0.5, problem.steps, where=problem.steps > 0.0, out=np.zeros(k)))
        first, second = (sparse.csr_matrix(matrix) for matrix in problem.rates)
        parts += [(expand(first, 0, nq), nq), (expand(second, 0, nq), nq)]
        half_rate, before = half @ (ahead - own), sparse.diags(np.ones(k - 1), -1)
        parts += [(expand(matrix, 1, 1), 1) for matrix in (own, ahead, half_rate, before @ half_rate)]
    none = sparse.csr_matrix((k * rows, offsets[-1]))
    parts.append((expand(own, 2, rows) if problem.released is not None else none, rows))
    heights = [height for _, height in parts]
    starts, total = np.cumsum([0, *heights]), sum(heights)
    order = np.concatenate([np.add.outer(np.arange(k) * total + start, np.arange(height)).ravel()
                            for start, height in zip(starts, heights, strict=False)])  # fmt: skip
    stacked = sparse.csr_matrix(sparse.vstack([part for part, _ in parts]))
    return sparse.csc_matrix(stacked[np.argsort(order)]), sizes


def solve_problem(problem: PlanningProblem) -> Solution:
    """Build and solve the program of a problem."""
    clock, (k, nq) = time.process_time(), problem.q_start.shape
    program = build_nlp(problem)
    offsets = program.offsets
    begin, lower, upper = np.zeros(offsets[-1]), np.full(offsets[-1], -np.inf), np.full(offsets[-1], np.inf)
    joints, squares, slacks = (slice(a, b) for a, b in pairwise(offsets))
    lower[joints], upper[joints] = problem.lower.ravel(), problem.upper.ravel()
    begin[joints] = problem.guess.ravel()
    if problem.timed:
        lower[squares], upper[squares] = 1e-8, 1.0
        begin[squares] = problem.square
        for start, end in problem.runs:
            lower[squares][[start, end]] = upper[squares][[start, end]] = 0.0
    if problem.released is not None:
        lower[slacks].reshape(k, -1)[:, -1] = 0.0
        held = np.repeat(~problem.released, problem.pose_rows + 1)
        lower[slacks][held] = upper[slacks][held] = 0.0
    numbers = _pack(problem).ravel()
    bounds = [np.broadcast_arrays(*limit.bounds(problem), np.zeros((k, size)))
              for limit, size in zip(problem.limits, program.sizes, strict=True)]  # fmt: skip
    low, high = (np.hstack([each[side] for each in bounds]) for side in (0, 1))
    begin = np.clip(begin, lower, upper)
    if problem.released is not None:  # the initial slack is the residual of the guess
        g = np.array(program.solver.get_function("nlp_g")(begin, numbers)).reshape(k, -1)
        excess = np.maximum(g - high, 0.0)[:, problem.pose_rows :].max(axis=1, keepdims=True, initial=0.0)
        begin[slacks] = np.hstack([g[:, : problem.pose_rows], excess]).ravel()
    found = program.solver(x0=np.clip(begin, lower, upper), p=numbers, lbx=lower, ubx=upper,
                           lbg=low.ravel(), ubg=high.ravel())  # fmt: skip
    stats = program.solver.stats()
    x, g, pulls = (np.array(found[name])[:, 0] for name in ("x", "g", "lam_g"))
    g, pulls = g.reshape(k, -1), pulls.reshape(k, -1)
    bound_pulls = np.array(found["lam_x"])[:, 0][joints]
    violation = float(np.maximum(low - g, g - high).max(initial=0.0))
    multipliers, active, at = {}, {}, 0
    for limit, size in zip(problem.limits, program.sizes, strict=True):
        if not size:
            multipliers[limit.name] = bound_pulls.reshape(k, nq)
            near = (np.minimum(x[joints] - lower[joints], upper[joints] - x[joints]) < ACTIVE).reshape(k, nq)
            active[limit.name] = (near & (problem.lower < problem.upper)).any(axis=1)
            continue
        part = slice(at, at + size)
        at += size
        multipliers[limit.name] = pulls[:, part]
        if (low[:, part] < high[:, part]).any():
            near = np.minimum(g[:, part] - low[:, part], high[:, part] - g[:, part]) < ACTIVE
            active[limit.name] = (near | (np.abs(pulls[:, part]) > 1e-4)).any(axis=1)
    success = bool(stats["success"]) and violation < 1e-7
    status, iterations = str(stats["return_status"]), int(stats["iter_count"])
    spent = time.process_time() - clock
    LOG.debug("program of %d stations: %s, %d iterations, %.2f s, violation %.1g", k, status, iterations, spent,
              violation)  # fmt: skip
    slack = x[slacks].reshape(k, -1)[:, :-1] if problem.released is not None else np.zeros((k, problem.pose_rows))
    return Solution(
        problem, x[joints].reshape(k, nq), x[squares] if problem.timed else np.ones(k),
        slack, success, status, iterations, spent, violation, multipliers, active,
    )  # fmt: skip


def explain_conflict(solution: Solution) -> str:
    """Name conflicting limits and their waypoint; "" if the program is solved and no released station misses its pose.

    After a failed solve these are the limits with the greatest multipliers, at the station with their greatest sum;
    after a compromise, the limits at the station with the greatest pose error.
    """
    missed = np.abs(solution.slack).max(axis=1)
    if solution.success and missed.max(initial=0.0) < MISSED:
        return ""
    size = {name: np.abs(pull) for name, pull in solution.multipliers.items() if pull.size}
    total = np.sum([pull.max(axis=1) for pull in size.values()], axis=0)
    station = int(np.argmax(missed if solution.success else total))
    largest = max(float(pull[station].max()) for pull in size.values())
    joints, names = solution.problem.joints, []
    for limit in solution.problem.limits:
        pull = size.get(limit.name)
        if pull is not None and pull[station].max() > 0.1 * largest:
            own = f" of {joints[int(pull[station].argmax()) % len(joints)]}" if limit.of_joints else ""
            names.append(f"{limit.name.replace('_', ' ')}{own}")
    names = names if "pose" in names else ["pose", *names]
    waypoint = int(solution.problem.waypoint[station])
    status = "" if solution.success else f" ({solution.status})"
    return f"{' and '.join(names)} conflict at waypoint {waypoint}{status}"


def _state_station(problem: PlanningProblem) -> tuple[Station, list[ca.SX]]:
    """Build the expressions of one station; return it and the inputs of its functions: variables and data."""
    chain, nq, rows = problem.chain, problem.chain.nq, problem.pose_rows
    q, ahead = ca.SX.sym("q", nq), ca.SX.sym("q_next", nq)
    names = [("rate", nq), ("change", nq), ("square", 1), ("square_next", 1), ("half_rate", 1), ("half_rate_before", 1)]
    speed = {name: ca.SX.sym(name, size) for name, size in names if problem.timed}
    slack, excess = ca.SX.sym("slack", rows), ca.SX.sym("excess")
    data = {name: ca.SX.sym(name, values.shape[1]) for name, values in _list_numbers(problem).items()}
    loaded = build_loaded_function(chain, TIMED_STEPS if problem.timed else STEPS)
    position, rotation, _ = loaded(q, data["wrench"], data["bias"], data["theta"], data["loaded"])
    position = position + data["shift"]
    if problem.turn is not None:
        rotation = ca.mtimes(rotation, ca.reshape(data["turn"], 3, 3))
    wanted = ca.reshape(data["rotation"], 3, 3)
    missed = [ca.mtimes(wanted.T, position - data["position"])]
    if chain.nq >= 5:  # with fewer joints the tip determines the axis
        missed += [ca.dot(wanted[:, side], rotation[:, 2]) for side in (0, 1)]
    if not problem.spin_free:
        missed.append(ca.dot(wanted[:, 1], rotation[:, 0]))
    none = ca.SX(0, 1)
    station = Station(
        q=q, q_next=ahead, departure=q - data["q_start"], step=data["step"], inverse_step=data["inverse_step"],
        slack=slack, **{name: speed.get(name, none) for name, _ in names},
        excess=excess, missed=ca.vertcat(*missed), wrench=data["wrench"], programmed=data["programmed"],
        frames=locate_symbolic(chain, q), numbers={name: data[name] for name in problem.term_data},
    )  # fmt: skip
    return station, [ca.vertcat(q, ahead, *speed.values(), slack, excess), ca.vertcat(*data.values())]


def _list_numbers(problem: PlanningProblem) -> dict[str, Array]:
    """List the data of every station by name. Shapes (k, c)."""
    k, steps = len(problem), problem.steps
    inverse = np.divide(1.0, steps, where=steps > 0.0, out=np.zeros(k))
    turn = {} if problem.turn is None else {"turn": _flat(problem.turn)}
    return {
        "position": problem.position, "rotation": _flat(problem.rotation), "wrench": problem.wrench,
        "programmed": problem.position if problem.programmed is None else problem.programmed,
        "bias": problem.bias, "theta": problem.theta, "loaded": problem.loaded[:, None], "q_start": problem.q_start,
        "step": steps[:, None], "inverse_step": inverse[:, None],
        "shift": np.zeros((k, 3)) if problem.shift is None else problem.shift, **turn, **problem.term_data,
    }  # fmt: skip


def _pack(problem: PlanningProblem) -> Array:
    """Stack the data of every station horizontally. Shape (k, c)."""
    return np.hstack([np.asarray(values, float) for values in _list_numbers(problem).values()])


def _flat(rotation: Array) -> Array:
    """Flatten (k, 3, 3) column by column, as in CasADi."""
    return np.swapaxes(rotation, 1, 2).reshape(len(rotation), 9)
