"""Identify compliances, geometry and any effect of a robot from poses measured under load, with intervals.

In: a robot and the settled rows of a log (`compplan.measurement.fit.rows`). Out: values with covariance, what cannot be
told apart and why, the updated robot with its uncertainty (`update`). The equation: x_i = x(p, q_i, w_i) + noise, x the
exact loaded pose of `compplan.effects` (`forward`), p springs, parameters of effects and frames (`parameters`);
weighted, robust Gauss-Newton (`estimate`), judged on poses left out
(`compplan.measurement.fit.intervals`), without springs that are not surely above zero (`select_springs`).
"""

from compplan.identification.estimate import Estimate, Inseparable, estimate_parameters
from compplan.identification.parameters import (
    FreeRobot,
    Parameter,
    build_structure,
)
from compplan.identification.reduce import ReducedModel, reduce_model
from compplan.measurement.fit.rows import KNOWN_FRAMES, Rows
