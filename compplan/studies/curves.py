"""The cost of being wrong: deviation of each strategy against the error of the model, everything else as modelled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from compplan.robot import Array
from compplan.studies.evaluation import run_strategy
from compplan.studies.factors import PARTS
from compplan.studies.sampling import Cells
from compplan.studies.study import Study, thin_study

#: True compliance over the model's.
RATIOS = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5])
#: True level of the wrench over the predicted one.
LEVELS = RATIOS
#: Waypoints that the curves look at.
WAYPOINTS = 300


@dataclass(frozen=True)
class ErrorCurves:
    """Deviation against model error.

    Attributes:
        ratio: True over modelled value. Shape (k,).
        by_compliance: By strategy, rms deviation where all compliances are `ratio` times the model's. Shape (k,). [m]
        by_wrench: By strategy, rms deviation where the wrench is `ratio` times the predicted one. Shape (k,). [m]
        waypoints: Number of waypoints looked at.

    """

    ratio: Array
    by_compliance: Mapping[str, Array]
    by_wrench: Mapping[str, Array]
    waypoints: int


def trace_model_error(study: Study, *, most_waypoints: int = WAYPOINTS) -> ErrorCurves:
    """Run every strategy in cells without noise whose compliances, or whose wrench, differ from the model's."""
    thin = thin_study(study, most_waypoints)
    ones = np.ones_like(RATIOS)
    compliance, wrench = noise_free_robots(thin, RATIOS, ones), noise_free_robots(thin, ones, LEVELS)
    return ErrorCurves(
        RATIOS,
        {name: _rms(thin, run_strategy(thin, name, compliance)) for name in thin.strategies},
        {name: _rms(thin, run_strategy(thin, name, wrench)) for name in thin.strategies},
        len(thin.task),
    )


def noise_free_robots(study: Study, compliance: Array, level: Array) -> Cells:
    """Make cells without noise, with all compliances and the wrench times factors. Shape (b,) each."""
    at, b, n = study.surroundings, len(compliance), len(study.task)
    nq = len(at.q)
    still, rest = np.zeros((nq, b, n)), np.zeros((3, b, n))
    wrench = at.wrench[:, None, :] * level[:, None]
    return Cells(
        factor=np.tile(compliance, (at.n_springs, 1)),
        zero=np.zeros((nq, b)),
        drive=still,
        causes=np.zeros((len(at.scale), b)),
        shift=rest,
        wrench=[wrench] * PARTS,
        repeat=np.zeros((PARTS, 3, b)),
        motor=[still] * PARTS,
        link=[still] * PARTS,
        force=np.zeros((6, b, n)),
        tracker=[rest] * (PARTS - 1),
    )


def _rms(study: Study, deviation: Array) -> Array:
    return np.asarray(np.sqrt((deviation[:, :, study.cut] ** 2).sum(axis=0).mean(axis=-1)))
