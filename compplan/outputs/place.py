"""What `compplan place` writes: place.json, report.html and its two pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compplan.files.origin import describe_origin
from compplan.files.tables import write_json
from compplan.files.transaction import replace_folder
from compplan.job.job import Job
from compplan.posture.place import PlaceResult, summarise_placement
from compplan.report.place_map import draw_place_map
from compplan.report.place_page import write_place_page
from compplan.report.posture_map import draw_map_picture


def write_placement(result: PlaceResult, job: Job, folder: Path) -> dict[str, Any]:
    """Write place.json and its pictures; return what place.json holds.

    Args:
        result: Where the part should stand.
        job: The job.
        folder: The folder.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    summary = {**summarise_placement(result, job), "made_by": describe_origin()}
    with replace_folder(folder, "place") as part:
        pictures = draw_place_map(result), draw_map_picture(result.stance.map)
        (part / "place_map.png").write_bytes(pictures[0])
        (part / "posture_map.png").write_bytes(pictures[1])
        write_place_page(summary, *pictures, part / "report.html")
        write_json(part / "place.json", summary)
    return summary
