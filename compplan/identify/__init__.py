"""Identify compliances, frames and geometry of a robot from measured poses under load."""

from compplan.identify.estimate import Estimate, estimate_parameters
from compplan.identify.forward import KNOWN_FRAMES, predict_rows
from compplan.identify.observations import Observations, make_observations
from compplan.identify.parameters import FreeRobot, Parameter, build_structure, candidate_springs, own_springs
from compplan.identify.reduce import ReducedModel, reduce_model
from compplan.identify.separability import Inseparable

__all__ = [
    "KNOWN_FRAMES",
    "Estimate",
    "FreeRobot",
    "Inseparable",
    "Observations",
    "Parameter",
    "ReducedModel",
    "build_structure",
    "candidate_springs",
    "estimate_parameters",
    "make_observations",
    "own_springs",
    "predict_rows",
    "reduce_model",
]
