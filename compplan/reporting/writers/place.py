"""What `compplan place` writes: place.json and report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json
from compplan.io.transaction import replace_folder
from compplan.job.job import Job
from compplan.planning.posture.place import PlaceResult, summarise_placement
from compplan.reporting.place_map import draw_place_map
from compplan.reporting.place_page import write_place_page


def write_placement(result: PlaceResult, job: Job, folder: Path) -> dict[str, Any]:
    """Write place.json and its page; return what place.json holds.

    Args:
        result: Where the part should stand.
        job: The job.
        folder: The folder.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    summary = {**summarise_placement(result, job), "made_by": describe_origin()}
    with replace_folder(folder, "place") as part:
        write_place_page(summary, draw_place_map(result), result.posture_choice.map, part / "report.html")
        write_json(part / "place.json", summary)
    return summary
