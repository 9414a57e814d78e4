"""What somebody meets who starts: commands that are fast, names that are nearly right, files of another kind."""

from __future__ import annotations

import subprocess
import sys

from compplan.job.job import Job, check_job

JOB = {"schema": 1, "robot": "ur10", "toolpath": "part.nc"}


def test_the_command_line_chooses_the_threads_before_numpy_is_imported() -> None:
    words = "import sys, compplan.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def test_chatter_is_judged_where_the_job_has_its_table_alone() -> None:
    assert not check_job(JOB).stability.judge
    assert check_job({**JOB, "stability": {}}).stability.judge
    assert not check_job({**JOB, "stability": {"judge": False}}).stability.judge
    assert Job.model_fields["stability"].default.damping == 0.03
