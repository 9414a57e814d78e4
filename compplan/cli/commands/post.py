"""`compplan post`: from a CAM file to the corrected robot program, in one command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from compplan.cli.commands.plan import carry_out
from compplan.cli.options import INPUT, json_summary, keep_stated, out_folder, robot_option, take_cam_options
from compplan.controllers.writers import WRITERS
from compplan.errors import InputError
from compplan.io.tomlfile import check_table, read_named_table

#: Where the tables and keys of the job that this command makes up come from.
OPTIONS = {"toolpath": "CAMFILE"} | {
    name: f"--{name}" for name in ("robot", "part", "tool", "tools", "process", "cam", "plan", "output")
}


@click.command()
@click.argument("camfile", type=INPUT)
@click.option(
    "--profile", metavar="FILE", help="Shop profile (compplan init profile): what it has may be left out here."
)
@robot_option("A folder in robots/ or a path.", required=False)
@click.option("--part", metavar="X,Y,Z[,RX,RY,RZ] | FILE", help="Part frame, mm and rotation vector.")
@click.option("--tool", metavar="FILE", help="TOML file as [tool] of a job; left out: the robot folder's TCP.")
@click.option("--tools", metavar="FILE", help="Tools by T number: TOML with [[tool]], CSV, or a tool library (Fusion, "
              "HSM, LinuxCNC, Heidenhain) whose lengths count from the spindle that --tool describes.")  # fmt: skip
@click.option("--process", metavar="FILE", help="TOML file as [process] of a job; left out: no force is predicted.")
@click.option("--program", "programs", multiple=True,
              help=f"Language, may be given more than once: {', '.join(WRITERS)}.")  # fmt: skip
@click.option("--cam", metavar="FILE", help="TOML file as [cam] of a job: how the file is read.")
@take_cam_options
@click.option("--plan", "wishes", metavar="FILE", help="TOML file as [plan] of a job: strategy, tolerance, posture.")
@click.option("--output", metavar="FILE", help="TOML file as [output] of a job: signals (io), templates, ..")
@out_folder
@json_summary
def command(
    camfile: Path, profile: str | None, robot_name: str | None, part: str | None, tool: str | None, tools: str | None,
    process: str | None, programs: tuple[str, ...], cam: str | None, wishes: str | None, output: str | None,
    folder: Path, as_json: bool, **of_cam: Any,
) -> None:  # fmt: skip
    """Read CAMFILE, plan it and write the programs, plan.json, joints.csv and report.html.

    Example: compplan post part.nc --robot kuka_kr240 --part 1800,0,700 --program krl --out out
    """
    from compplan.reporting.writers.post import make_post_job

    stated = keep_stated(**of_cam)
    of_file = {**({} if cam is None else read_named_table(cam, "cam")[0]), **stated} if stated else cam
    stands_in = folder.absolute() / f"{camfile.stem}.toml"
    place = None if part is None else read_part(part)
    note = "No --process is given: no force is predicted, the arm bends under weights alone." if process is None else ""
    try:
        job = make_post_job(
            camfile, robot=robot_name, part=place, program=programs, profile=profile,
            tool=tool, tools=tools, process=process, cam=of_file, plan=wishes,
            output=None if output is None else read_output(output), stands_in=stands_in,
        )  # fmt: skip
        carry_out(job, folder, as_json=as_json, note=note)
    except InputError as error:
        raise name_option(error, stands_in) from None


def name_option(error: InputError, stands_in: Path) -> InputError:
    """Return an error about a job that nobody wrote as one about the option that the value came from."""
    if error.file != str(stands_in):
        return error
    table, _, key = str(error.where or "").partition(".")
    if table.startswith("tool["):
        table, key = "tools", f"{table}.{key}".rstrip(".")
    if table == "output" and key.startswith("programs"):
        return InputError(error.message, where="--program")
    option = OPTIONS.get(table)
    return InputError(error.message, where=" ".join(word for word in (option, key) if word) or None)


def read_part(text: str) -> dict[str, Any]:
    """Read the value of --part: three or six numbers, or a file.

    Raises:
        InputError: If it is neither.
    """
    from compplan.reporting.writers.post import read_part as read_numbers
    from compplan.reporting.writers.post import read_table_of_job

    if Path(text).suffix == ".toml":
        return read_table_of_job("part", text)
    try:
        return read_numbers([float(word) for word in text.split(",")])
    except (ValueError, InputError):
        message = f"--part is {text!r}, expected X,Y,Z in mm, or X,Y,Z,RX,RY,RZ with a rotation vector in deg"
        raise InputError(message) from None


def read_output(file: str) -> dict[str, Any]:
    """Read [output] from a file of its own, or from the job that it stands in; files of lines are relative to it.

    Raises:
        InputError: If a key is not what it has to be, those among them that the command line replaces.
    """
    from compplan.job.output import OutputTable
    from compplan.reporting.writers.post import read_table_of_job

    table = read_table_of_job("output", file)
    check_table(OutputTable, table, file=file)
    return table
