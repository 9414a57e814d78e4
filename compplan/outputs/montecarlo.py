"""What `compplan montecarlo` writes: montecarlo.json and report.html beside the samples."""

from __future__ import annotations

import json
from pathlib import Path

from compplan.files.tables import write_text
from compplan.report.montecarlo_page import write_montecarlo_report
from compplan.study.job_study import JobStudy


def write_study(study: JobStudy, folder: Path) -> list[Path]:
    """Write montecarlo.json and report.html.

    Args:
        study: The study.
        folder: Folder to write to.

    Returns:
        The files written.

    Raises:
        InputError: If the folder cannot be written.

    """
    files = [write_montecarlo_report(study, folder), folder / "montecarlo.json"]
    write_text(files[1], json.dumps(study.summary, indent=2) + "\n")
    return sorted(files)
