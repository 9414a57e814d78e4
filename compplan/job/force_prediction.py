"""Predicted force along a job's path, and its comparison with a measured log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compplan.io.tables import Array
from compplan.job.job import Job
from compplan.job.loading import load_path
from compplan.process.engagement import Engagement
from compplan.process.fit import ForceFit, fit_forces, read_force_log
from compplan.process.force_law import ForceLaw
from compplan.toolpath.contact import path_axes
from compplan.toolpath.toolpath import Toolpath


@dataclass(frozen=True)
class ForcePrediction:
    """The force along a job's path."""

    job: Job  #: The job.
    nominal: Toolpath  #: The path with its wrench, base frame.
    law: ForceLaw  #: Force law of the process.
    fit: ForceFit | None  #: The comparison with a log, or None.

    @property
    def wrench(self) -> Array:
        """The wrench on the tool at its tip, base axes. Shape (n, 6). [N, N m]"""
        return np.zeros((len(self.nominal), 6)) if self.nominal.wrench is None else self.nominal.wrench

    @property
    def local(self) -> Array:
        """The force in path axes. Shape (n, 3). [N]"""
        return np.asarray(np.einsum("nji,nj->ni", path_axes(self.nominal), self.wrench[:, :3]))

    @property
    def engagement(self) -> Engagement | None:
        """Engagement of a cutter, or None."""
        return None if self.law.cutting is None else self.law.cutting.engagement

    @property
    def notes(self) -> list[str]:
        """Notes, one sentence each."""
        return [*self.nominal.notes, *([self.law.note] if self.law.note else [])]


def predict_forces(job: Job, log: Path | None = None) -> ForcePrediction:
    """Predict engagement and force along a job's path, and compare them with a log, if any.

    Raises:
        InputError: If toolpath, process or log are invalid.

    """
    nominal, law = load_path(job)
    law = replace(law, learned=None)  # a log is compared with the model
    fit = None if log is None else fit_forces(read_force_log(log), law, nominal, log)
    return ForcePrediction(job, nominal, law, fit)
