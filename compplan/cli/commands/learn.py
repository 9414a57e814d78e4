"""`compplan learn`: the next program from the measured deviations of a cut part."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.commands.options import complete_robots, posture_kept
from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.io.parsing import LEAST_SIGMA_MM
from compplan.io.tables import dump_json


@click.command("learn")
@click.argument("job", type=click.Path(path_type=Path))
@click.argument("measured", type=click.Path(path_type=Path))
@click.option("--robot", "robot_name", required=True, shell_complete=complete_robots,
              help="Robot folder that the part's program was planned with.")  # fmt: skip
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--frame", type=click.Choice(["part", "base"]), default="part", show_default=True,
              help="Frame of the measured points.")  # fmt: skip
@click.option("--align", type=click.Choice(["datum", "best_fit"]),
              help="Whether the points stand where their frame says, or a shift and turn of all is fitted and taken"
              " off: then a shift of the whole part teaches nothing. Left out: datum, but such a shift is asked about.",
              )  # fmt: skip
@click.option("--sigma-mm", type=click.FloatRange(LEAST_SIGMA_MM, 20.0),
              help="Standard deviation of points whose file states none; assumed: 0.02, of a scan 0.05.")  # fmt: skip
@click.option("--instrument", type=click.Path(path_type=Path),
              help="TOML file of the instrument: its sigma_mm, where --sigma-mm is left out.")  # fmt: skip
@click.option("--mesh", type=click.Path(path_type=Path),
              help="Nominal surface of the part, STL or PLY in mm, in the frame of the points: they count along its"
              " normals.")  # fmt: skip
@click.option("--reach-mm", type=click.FloatRange(0.0, 1000.0, min_open=True),
              help="How far from the path of the tip the tool makes that surface; else 1 mm more than the radius of the"
              " cutter in [process].")  # fmt: skip
@click.option("--assume-ok", is_flag=True, help="Learn points that are asked about as they are.")
@posture_kept
@click.option("--json", "as_json", is_flag=True, help="Print learn.json to stdout.")
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
    from compplan.cli.commands.progress import show_progress
    from compplan.errors import InfeasibleError
    from compplan.job.operations import load_one_job
    from compplan.learning.measured_path import reach_of
    from compplan.learning.part import learn_from_part
    from compplan.learning.surface import read_surface
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
    if as_json:
        click.echo(dump_json(summary, indent=2))
    else:
        click.echo(teaching.after.verdict.sentence)
        click.echo(f"measured {summary['measured_rms_mm']:.4g} mm rms at {summary['points']} points")
        for note in teaching.notes:
            click.echo(note)
        if teaching.lesson.taken:
            band = summary["band_after_mm"]
            click.echo(
                f"expected of the next part: {summary['expected_rms_mm']:.4g} mm rms; its tip within"
                f" {band['p95_max']:.3g} mm with 95 %, within {band['p95_max_in_measured_directions']:.3g} mm in the"
                " directions that were measured"
            )
        click.echo(f"wrote {', '.join(summary['files'])} to {folder}")
        if teaching.lesson.taken:
            click.echo(f"next: cut a part with it, measure that, and learn again with --robot {folder / 'robot'}")
    if teaching.after.status != "solved":
        failing, limits = teaching.after.command.failures, set(teaching.after.command.failures.values())
        message = f"{teaching.after.explain_failures()}; the best compromise is written"
        raise InfeasibleError(message, waypoints=sorted(failing), limits=sorted(limits))
