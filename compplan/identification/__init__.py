"""Identify compliances, geometry and other effects of a robot from poses measured under load, with intervals.

Input: a robot and the selected rows of a log (`compplan.measurement.fit.rows`). Output: values with covariance, the
inseparable parameters with the reason, the updated robot with its uncertainty (`update`). The model is x_i = x(p, q_i,
w_i) + noise: x is the exact loaded pose of `compplan.effects` (`forward`), p are springs, parameters of effects and
frames (`parameters`). Weighted, robust Gauss-Newton (`estimate`) is validated on held-out poses
(`compplan.measurement.fit.intervals`); springs not significantly above zero are dropped (`select_springs`).
"""

from compplan.identification.estimate import Estimate, Inseparable, estimate_parameters
from compplan.identification.parameters import FreeRobot, Parameter, build_structure
from compplan.identification.reduce import ReducedModel, reduce_model
from compplan.measurement.fit.rows import KNOWN_FRAMES, Rows
