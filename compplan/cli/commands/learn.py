"""`compplan learn`: the next program from the measured deviations of a cut part."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import INPUT, assume_ok, json_summary, out_folder, posture_kept, robot_option
from compplan.cli.terminal import show, show_progress
from compplan.errors import InfeasibleError
from compplan.io.parsing import LEAST_SIGMA_MM


@click.command("learn")
@click.argument("job", type=INPUT)
@click.argument("measured", type=INPUT)
@robot_option("Robot folder that the part's program was planned with.")
@out_folder
@click.option("--frame", type=click.Choice(["part", "base"]), default="part", show_default=True,
              help="Frame of the measured points.")  # fmt: skip
@click.option("--align", type=click.Choice(["datum", "best_fit"]),
              help="Take the points as their frame states (datum), or remove a fitted shift and turn of all points"
              " first (best_fit). Left out: datum, with a question where such a shift is large.",
              )  # fmt: skip
@click.option("--sigma-mm", type=click.FloatRange(LEAST_SIGMA_MM, 20.0),
              help="Standard deviation of points whose file states none; assumed: 0.02, of a scan 0.05.")  # fmt: skip
@click.option("--instrument", type=INPUT,
              help="TOML file of the instrument: its sigma_mm, where --sigma-mm is left out.")  # fmt: skip
@click.option("--mesh", type=INPUT, help="Nominal surface of the part, STL or PLY in mm, in the frame of the points: "
              "they count along its normals.")  # fmt: skip
@click.option("--reach-mm", type=click.FloatRange(0.0, 1000.0, min_open=True),
              help="How far from the path of the tip the tool makes that surface; else 1 mm more than the radius of the"
              " cutter in [process].")  # fmt: skip
@assume_ok
@posture_kept
@json_summary
def command(
    job: Path, measured: Path, robot_name: str, folder: Path, frame: str, align: str | None, sigma_mm: float | None,
    instrument: Path | None, mesh: Path | None, reach_mm: float | None, assume_ok: bool, keep: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Learn from MEASURED points of a part cut with JOB: write the corrected program and the updated robot folder.

    MEASURED has columns x_mm y_mm z_mm of the attained tool tip, and where they are known s_mm (path length) and
    sigma_mm; a probe along normals has reading_mm along dir_i dir_j dir_k from there. Or it is a scan of the surface
    that the tip touches, in mm: STL, PLY, XYZ, or a table without a head (x y z [nx ny nz]); with --mesh of any surface
    that the tool makes. The next part learns with --robot DIR/robot.

    Example: compplan learn paths/circle_500mm.toml part1.csv --robot kuka_kr270 --out part2
    """
    from compplan.job.operations import load_one_job
    from compplan.learning.measured_path import reach_of
    from compplan.learning.part import learn_from_part
    from compplan.learning.scan import read_surface
    from compplan.measurement.instrument import read_instrument
    from compplan.reporting.learn import write_learning

    checked = load_one_job(job, keep=keep)
    if instrument is not None and sigma_mm is None:
        sigma_mm = read_instrument(instrument).instrument.sigma_mm
    reach = reach_of(checked.process) if reach_mm is None else reach_mm * 1e-3
    surface = None if mesh is None else read_surface(mesh, reach)
    with show_progress() as announce:
        teaching = learn_from_part(
            checked, robot_name, measured, in_base=frame == "base", align=align,
            sigma=None if sigma_mm is None else sigma_mm * 1e-3, sure=assume_ok, surface=surface, announce=announce,
        )  # fmt: skip
        announce("report")
        summary = write_learning(teaching, folder)
    plan, taken, band = teaching.after, teaching.lesson.taken, summary["band_after_mm"]
    lines = [plan.verdict.sentence, f"measured {summary['measured_rms_mm']:.4g} mm rms at {summary['points']} points"]
    lines += teaching.notes
    if taken:
        lines.append(
            f"expected of the next part: {summary['expected_rms_mm']:.4g} mm rms; its tip within"
            f" {band['p95_max']:.3g} mm with 95 %, within {band['p95_max_in_measured_directions']:.3g} mm in the"
            " directions that were measured"
        )
    lines.append(f"wrote {', '.join(summary['files'])} to {folder}")
    if taken:
        lines.append(f"next: cut a part with it, measure that, and learn again with --robot {folder / 'robot'}")
    show(summary, as_json, lines)
    if plan.status != "solved":
        failing, limits = plan.command.failures, set(plan.command.failures.values())
        message = f"{plan.explain_failures()}; the best compromise is written"
        raise InfeasibleError(message, waypoints=sorted(failing), limits=sorted(limits))
