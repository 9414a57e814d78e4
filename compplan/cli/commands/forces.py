"""`compplan forces`: engagement and force along the path, and which coefficients fit a measured log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from compplan.cli.options import INPUT, json_summary, out_folder
from compplan.cli.terminal import show, show_progress
from compplan.errors import InputError
from compplan.process.force_models import FORCE_MODELS


@click.command(epilog=f"Force models of a job: {', '.join(FORCE_MODELS)}.")
@click.argument("job", type=INPUT)
@out_folder
@click.option("--log", type=INPUT, help="Measured forces: CSV with s_mm or t_s, the length or the time cut so far, and "
              "fx_N fy_N fz_N, part axes; mx_Nm my_Nm mz_Nm at the tip and power_W are used too.")  # fmt: skip
@click.option("--write", "table", type=INPUT, help="With --log: write the fitted coefficients to this file, for "
              "[process] of a later job; process.toml of a robot folder takes the level instead, which later "
              "plans read.")  # fmt: skip
@json_summary
def command(job: Path, folder: Path, log: Path | None, table: Path | None, as_json: bool) -> None:
    """Predict engagement and force along the path of JOB: write forces.json, forces.csv, report.html, stock.stl.

    stock.stl is what a cutter leaves of the stock, part frame, mm.

    Example: compplan forces examples/forces/pocket.toml --out out
    """
    from compplan.job.force_prediction import predict_forces
    from compplan.job.operations import load_one_job
    from compplan.process.learned_force import FILE as LESSON
    from compplan.reporting.forces import write_coefficients, write_forces, write_level

    if table is not None and log is None:
        raise InputError("--write needs --log, the measured forces")
    checked = load_one_job(job)
    with show_progress() as announce:
        announce("forces: engagement and wrench along the path")
        found = predict_forces(checked, log)
        if table is not None:
            (write_level if table.name == LESSON else write_coefficients)(found, table)
        announce("write: forces.json, forces.csv, report.html")
        summary = write_forces(found, folder)
    lines = [*_describe(summary), *summary["notes"]]
    if table is not None:
        hint = "in a job: its [process.coefficients] in place of material"
        lines.append(f"wrote {table}; {'plans with this robot folder read it' if table.name == LESSON else hint}")
    left = ", stock.stl" if "engagement" in summary else ""
    show(summary, as_json, [*lines, f"wrote forces.json, forces.csv, report.html{left} to {folder}"])


def _describe(summary: Mapping[str, Any]) -> Iterator[str]:
    """Return in lines what forces.json holds."""
    force = summary["force_N"]
    yield (f"{summary['model']}: {summary['waypoints_in_contact']} of {summary['waypoints']} waypoints in contact, "
           f"force up to {force['max']:.4g} N, {force['mean_in_contact']:.4g} N on average there")  # fmt: skip
    if "engagement" in summary:
        cut = summary["engagement"]
        deep, wide = cut["axial_depth_mm"]["max"], cut["radial_width_mm"]["max"]
        yield f"axial depth up to {deep:.3g} mm, radial width up to {wide:.3g} mm"
    if "log" in summary:
        fit = summary["log"]
        yield (f"log: {fit['rows']} rows in the cut of {fit['rms_N']:.3g} N (rms), the prediction is off by "
               f"{fit['rms_before_N']:.3g} N, with fitted numbers by {fit['rms_after_N']:.3g} N")  # fmt: skip
        for number in fit["fitted"]:
            yield (f"  {number['name']}: {number['value']:.4g} {number['unit']} "
                   f"[{number['low']:.4g}, {number['high']:.4g}], {number['in_job']:.4g} in the job")  # fmt: skip
        yield from (f"  {note}" for note in fit["notes"])
