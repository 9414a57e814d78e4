"""What `compplan montecarlo` writes: montecarlo.json and report.html beside the samples."""

from __future__ import annotations

from pathlib import Path

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json
from compplan.io.transaction import list_files, replace_folder
from compplan.reporting.montecarlo_page import write_montecarlo_report
from compplan.studies.job_study import JobStudy


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
    with replace_folder(folder, "montecarlo") as part:
        write_montecarlo_report(study, part)
        write_json(part / "montecarlo.json", {**study.summary, "made_by": describe_origin()}, indent=2)
        names = list_files(part)
    return [folder / name for name in names]
