"""Fit a reduced model with one spring per joint to a full model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.identification.estimate import Estimate, estimate_parameters
from compplan.identification.parameters import build_structure
from compplan.measurement.campaign import make_log
from compplan.robot import Array, Robot, Spring
from compplan.statics.chain import build_chain
from compplan.statics.elastic import solve_equilibrium


@dataclass(frozen=True)
class ReducedModel:
    """A reduced robot and its difference from the full robot."""

    robot: Robot  #: The reduced robot: one spring about each commanded joint's axis.
    #: Compliance of each commanded joint; zero if it cannot be identified. Shape (nq,). [rad/(N m) or m/N]
    compliance: Array
    estimate: Estimate  #: The fit, with the parameters that cannot be identified and the reasons.
    residual: Array  #: Full minus reduced pose. Shape (n, 6). [m, rad]
    deflection: Array  #: Deflection of the full model at the same rows. Shape (n, 6). [m, rad]


def reduce_model(full: Robot, q: Array, wrench: Array, *, rotation_weight: float | None = 1.0) -> ReducedModel:
    """Fit joint compliances that approximate a full model (joints, links, base) [Mamedov2018].

    Minimises sum_i (|dp_i|^2 + (rotation_weight)^2 |dr_i|^2) between the exact loaded poses of both models, from the
    compliances of the full robot's springs about joint axes on.

    Args:
        full: The full robot.
        q: Poses at which both are compared. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
        rotation_weight: Weight of a rotation against a translation; None compares positions alone. [m/rad]

    Raises:
        InputError: If no joint compliance can be identified from these poses and loads.
        ShapeError: If an array does not have the shape above.
    """
    joint_compliance = {spring.joint: spring.compliance for spring in full.springs if spring.axis == "own"}
    springs = tuple(Spring(name, "own", joint_compliance.get(name, 1e-6), actuator=True) for name in full.joint_names)
    reduced = replace(full, springs=springs, link_elasticities=(), effects=())
    chain = build_chain(full)
    loaded, bare = solve_equilibrium(chain, q, wrench), solve_equilibrium(chain, q, np.zeros(6))
    # Unit micrometre: only the ratio of the weights matters; the motion by unloaded springs is far smaller.
    rotation = None if rotation_weight is None else loaded.rotation
    log = make_log(q, wrench, loaded.position, rotation, sigma=1e-6, sigma_rotation=1e-6 / (rotation_weight or 1.0))
    estimate = estimate_parameters(build_structure(reduced), log, sigma="stated")
    compliance = np.where(estimate.free, estimate.model_values, 0.0)
    fitted = tuple(replace(s, compliance=float(max(c, 0.0))) for s, c in zip(springs, compliance, strict=True))
    turn = np.einsum("nij,nkj->nik", loaded.rotation, bare.rotation)
    return ReducedModel(
        robot=replace(reduced, springs=fitted, sources={**full.sources, "compliance": f"reduced model of {full.name}"}),
        compliance=compliance,
        estimate=estimate,
        residual=estimate.residuals[:, :6],
        deflection=np.hstack([loaded.position - bare.position, Rotation.from_matrix(turn).as_rotvec()]),
    )
