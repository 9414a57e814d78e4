"""`compplan init`: write a commented job, a robot folder from a URDF, or an empty measurement log."""

from __future__ import annotations

import math
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import tomli_w

from compplan.cli.options import INPUT, robot_option
from compplan.cli.terminal import show, show_progress
from compplan.controllers.writers import WRITERS, list_languages
from compplan.controllers.writers.joint_convention import load_controller
from compplan.controllers.writers.post import read_post
from compplan.errors import CompplanError, InputError, UnknownNameError
from compplan.io.tables import write_text
from compplan.io.transaction import replace_folder
from compplan.job.called_tools import ANY_FEED, describe_assumed, read_called_tools
from compplan.job.commented_job import (
    choose_process,
    mount_tool,
    number_tools,
    set_force,
    set_place,
    shorten_job,
    write_job_text,
)
from compplan.job.profile import write_profile_text
from compplan.measurement.reading import write_log_text
from compplan.robot import Robot, load_robot, read_robot_folder
from compplan.robot.brands import CONTROLLERS
from compplan.robot.folder_template import TURNS, Skeleton, build_skeleton
from compplan.robot.rating import Rating
from compplan.toolpath.readers import find_reader, list_suffixes
from compplan.toolpath.readers.lines import read_bounded
from compplan.toolpath.reading import read_toolpath

#: Pitch of the example cone that shows what force the arm bears. [mm]
FEW_TURNS_MM = 5.0


@dataclass(frozen=True)
class Form:
    """What `compplan init` writes: how it is called, how many words that takes, and its options."""

    usage: str
    words: int
    options: tuple[str, ...]


FORMS = {
    "robot": Form("robot URDF", 2, ("tcp", "tool_axis", "controller", "payload", "reach", "mass", "out")),
    "template": Form("template LANGUAGE", 2, ("out",)),
    "profile": Form("profile --robot ROBOT", 1, ("robot_name", "out")),
    "log": Form("log --robot ROBOT", 1, ("robot_name", "out")),
    "schema": Form("--schema", 0, ("schema",)),
}
#: Any other first word is the file of a job.
JOB = Form("FILE", 1, ("robot_name", "toolpath", "short"))


@click.command()
@click.argument("words", nargs=-1, metavar="[FILE | profile | robot URDF | log | template LANGUAGE]")
@robot_option("Robot of the job, or of the log: folder or shipped robot.", required=False)
@click.option("--toolpath", default=None, help="Toolpath of the job, relative to it: CSV or a CAM file.")
@click.option("--tcp", default=None, help="init robot: frame of the tool centre point; left out: the end of the chain.")
@click.option("--tool-axis", type=click.Choice(list(TURNS)), default=None,
              help="init robot: axis of that frame that points out of the tool.")  # fmt: skip
@click.option("--controller", type=click.Choice(list(CONTROLLERS)), default=None,
              help="init robot: take its joint names, signs, configuration words, pendant frame.")  # fmt: skip
@click.option("--payload", type=click.FloatRange(0.1, 3000.0), default=None,
              help="init robot: rated payload in kg; with --reach it gives springs by a rule (assumed).")  # fmt: skip
@click.option("--reach", type=click.FloatRange(0.2, 10.0), default=None, help="init robot: reach in m.")
@click.option("--mass", type=click.FloatRange(1.0, 2e4), default=None,
              help="init robot: own weight in kg, to check the URDF's masses by.")  # fmt: skip
@click.option("--short", is_flag=True, help="A job of the keys that one needs first, without the others.")
@click.option("--out", type=INPUT, default=None, help="Folder of the robot, or file of the log or template.")
@click.option("--schema", is_flag=True, help="Print the JSON schema of a job, and write nothing.")
def command(words: tuple[str, ...], **options: Any) -> None:
    """Write a job FILE (default job.toml) in which every key is explained; a shop profile; a robot folder; a log.

    With a robot, the part is put where the arm reaches its path, the tool leaves the flange straight, and the forces
    of the example path are such as the arm bears: all assumed.

    Example: compplan init part.toml --robot ur10 --toolpath part.nc

    Example: compplan init robot arm.xacro --controller krc4 --payload 16 --reach 1.61 --out arm

    Example: compplan init template krl --out cell.src.jinja

    Example: compplan init profile --robot kuka_kr240 --out shop.toml

    Example: compplan init --schema

    Example: compplan init log --robot arm --out measurements.csv
    """
    form = _check_form(words, options)
    out, robot_name = options["out"], options["robot_name"]
    if options["schema"]:
        from compplan.job.schema import write_schema

        lines = [write_schema()]
    elif form is JOB:
        file = Path(words[0]) if words else Path("job.toml")
        lines = _init_job(file, robot_name, options["toolpath"], short=options["short"])
    elif words[0] == "robot":
        rating = _read_rating(options["payload"], options["reach"], options["mass"])
        made_of = (options["tcp"], options["tool_axis"], options["controller"])
        lines = _init_robot(Path(words[1]), *made_of, rating, out)
    elif words[0] == "template":
        lines = _init_template(words[1], out)
    elif words[0] == "profile":
        lines = _init_profile(robot_name, out or Path("shop.toml"))
    else:
        lines = _init_log(robot_name, out or Path("measurements.csv"))
    show({}, False, lines)


def _check_form(words: tuple[str, ...], options: Mapping[str, Any]) -> Form:
    """Return what is to be written; refuse words that are too few or too many, and options of another form."""
    form = FORMS["schema"] if options["schema"] else FORMS.get(words[0], JOB) if words else JOB
    if form is FORMS["schema"] and words:
        raise InputError(f"{words[0]!r} has no meaning in: compplan init --schema")
    if form is JOB and len(words) > 1:
        forms = "'profile', 'robot URDF', 'log' or 'template LANGUAGE'"
        raise InputError(f"init takes one FILE, {forms}, not {' '.join(words)!r}")
    if form is not JOB and len(words) != form.words:
        raise InputError(f"{len(words) - 1} words after {words[0]!r}, expected: compplan init {form.usage}")
    for name, value in options.items():
        if value and name not in form.options:
            option = name.removesuffix("_name").replace("_", "-")
            raise InputError(f"--{option} has no meaning in: compplan init {form.usage}")
    return form


def _read_rating(payload: float | None, reach: float | None, mass: float | None) -> Rating | None:
    if (payload is None) != (reach is None) or (mass is not None and payload is None):
        raise InputError("--payload, --reach and --mass: give payload and reach together, own weight beside them")
    if any(math.isnan(value) for value in (payload, reach, mass) if value is not None):
        raise InputError("--payload, --reach and --mass: nan is no number")
    return None if payload is None or reach is None else Rating(payload, reach, mass)


def _init_template(language: str, out: Path | None) -> list[str]:
    if language not in WRITERS:
        raise UnknownNameError("program language", language, list(WRITERS))
    file = out or Path(f"{language}.jinja")
    _refuse_existing(file)
    write_text(file, read_post(language))
    return [f'wrote {file}; next: [output] templates = {{ {language} = "{file.name}" }}']


def _init_job(file: Path, robot_name: str | None, toolpath: str | None, *, short: bool) -> list[str]:
    _refuse_existing(file)
    if file.suffix.lower() != ".toml":
        raise InputError(f"a job is a file that ends in .toml, not {str(file)!r}")
    text, place, assumed = write_job_text(), "", ""
    robot = None if robot_name is None else load_robot(robot_name, relative_to=file.parent)
    if robot is not None:
        text = text.replace('robot = "staubli_tx200" ', f"{_line('robot', str(robot_name))} ", 1)
        text = text.replace('programs = ["val3"]', f'programs = ["{_native_language(robot)}"]', 1)
        text = mount_tool(text, robot, used=toolpath is not None and not toolpath.lower().endswith(".csv"))
    if toolpath is not None:
        _check_toolpath(file.parent / toolpath)
        line = _line("toolpath", toolpath) + "\n\n"
        text = re.sub(r'# toolpath = "part.nc"\n.*?\n(?=\[part\])', lambda _: line, text, count=1, flags=re.DOTALL)
        text = choose_process(text, "columns" if toolpath.lower().endswith(".csv") else "milling")
        if not toolpath.lower().endswith(".csv"):
            try:
                tools = read_called_tools(file.parent / toolpath)
                text, assumed = number_tools(text, tools), describe_assumed(tools)
            except CompplanError as error:
                assumed = f"tools and spindle speeds are not taken from {toolpath}: {error}"
    if robot is not None:
        with show_progress() as announce:
            announce("place of the part")
            text, place = place_part(text, file)
            if toolpath is None:
                announce("force that the arm can carry")
                text = ease_force(text, file)
    write_text(file, shorten_job(text) if short else text)
    return [*filter(None, (place, assumed)), f"wrote {file}; next: compplan plan {file} --out out"]


def place_part(text: str, file: Path) -> tuple[str, str]:
    """Put the part of a job's text where its arm reaches the path; return the text and what there is to say.

    A toolpath that cannot be read as the text has it leaves the part where it is: it may need what the job says of it.
    """
    from compplan.job.job import check_job
    from compplan.job.operations import split_job
    from compplan.planning.plan import job_robot
    from compplan.planning.posture.place import find_first_place

    try:
        job = split_job(check_job(tomllib.loads(text), file))[0]
        found = find_first_place(job, job_robot(job))
    except CompplanError as error:
        return text, f"the part has the default place, its path was not tried ({error})"
    if found is None:
        return text, "no place was found from which this robot reaches the whole path; choose a larger one, or turn it"
    position = [round(1e3 * float(value), 1) + 0.0 for value in found[0]]
    why = "amid the places from which the arm reaches the path" if found[1] else "before the arm, not tried"
    return set_place(text, position, f"assumed: {why}; put yours"), f"the part stands at {position} mm (assumed: {why})"


def ease_force(text: str, file: Path) -> str:
    """Lower the force of a job's text to what its arm bears; it stays where the path cannot be followed."""
    from compplan.job.job import check_job
    from compplan.planning.first_force import bearable_share
    from compplan.process.force_models.isf import IsfProcess

    try:
        tables = tomllib.loads(text)
        tables["toolpath"]["pitch_mm"] = FEW_TURNS_MM
        job = check_job(tables, file)
        share = bearable_share(job)
    except CompplanError:
        return text
    if share == 1.0 or not isinstance(job.process, IsfProcess):
        return text
    axial, lateral = (_round_down(share * force) for force in (job.process.axial_N, job.process.lateral_N))
    return set_force(text, axial, lateral, "assumed: what this arm can carry there; put yours")


def _round_down(value: float) -> float:
    """Round a positive number down to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return round(math.floor(value / step) * step, 6)


def _check_toolpath(path: Path) -> None:
    """Refuse what is no toolpath; a CAM file is not read, for it may need what the job says of it."""
    if not path.is_file():
        raise InputError("no such toolpath (it counts from the folder of the job)", file=path)
    if path.suffix.lower() == ".csv":
        read_toolpath(path, feed=ANY_FEED)
    elif path.suffix.lower() not in list_suffixes() and find_reader(path, read_bounded(path)) is None:
        raise InputError(f"is no toolpath, expected a file that ends in .csv, {', '.join(list_suffixes())}", file=path)


def _init_robot(
    urdf: Path, tcp: str | None, tool_axis: str | None, controller: str | None, rating: Rating | None, out: Path | None
) -> list[str]:
    folder = out or Path(urdf.stem)
    if not folder.is_dir() or any(folder.iterdir()):  # a run that died may have left it empty
        _refuse_existing(folder)
    try:
        made = build_skeleton(urdf, tcp, tool_axis, controller, rating)
    except InputError as error:
        if tool_axis is not None or "which axis of" not in error.message or not sys.stdin.isatty():
            raise
        asked = f"The URDF {error.message.partition(';')[0]}. Which one does"
        axis = click.prompt(asked, type=click.Choice(list(TURNS)), err=True)
        made = build_skeleton(urdf, tcp, axis, controller, rating)
    with replace_folder(folder, "init") as new:
        for name, text in made.texts.items():
            write_text(new / name, text)
        for place, source in made.meshes.items():
            (new / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, new / place)
        read_robot_folder(new)
    return [*_describe_robot(made, controller), f"wrote {folder}; next: compplan doctor {folder}"]


def _describe_robot(made: Skeleton, controller: str | None) -> Iterator[str]:
    """Say what a new robot folder holds, what was left out and what is missing."""
    if made.springs:
        yield f"springs: {made.springs}, assumed by payload and reach (grade {made.grade})"
    else:
        yield "springs: none, the robot is rigid; --payload and --reach estimate those of six rotating joints"
    if made.mass_fault:
        yield f"masses: {made.mass_fault}; the masses are left out, correct the URDF and run init again"
    if made.missing:
        yield f"meshes: {len(made.meshes)} copied, {len(made.missing)} not found ({made.missing[0]})"
    if made.gaps:
        yield f"Cartesian programs lack {'; '.join(made.gaps)}"
    if controller is not None:
        yield ("controller.toml is derived from the geometry and not checked: compare two postures with the display, "
               "then set checked = true")  # fmt: skip


def _init_log(robot_name: str | None, file: Path) -> list[str]:
    if robot_name is None:
        raise InputError("init log needs --robot: its joints are columns")
    _refuse_existing(file)
    write_text(file, write_log_text(load_robot(robot_name)))
    return [f"wrote {file}; next, when it is filled in: compplan doctor {file} --robot {robot_name}"]


def _init_profile(robot_name: str | None, file: Path) -> list[str]:
    """Write a shop profile, in the language of the robot's controller."""
    _refuse_existing(file)
    robot = None if robot_name is None else load_robot(robot_name, relative_to=file.parent)
    language = "csv" if robot is None else _native_language(robot)
    write_text(file, write_profile_text(robot_name or "kuka_kr210_r2700_2", language))
    return [f'wrote {file}; next: profile = "{file.name}" in a job, or compplan post CAMFILE --profile {file}']


def _native_language(robot: Robot) -> str:
    """Return the language that the robot's own controller speaks, a table where none is known."""
    spoken = list_languages(load_controller(robot).name)
    return spoken[0] if len(spoken) < len(WRITERS) else "csv"


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise InputError("exists already; name another", file=path)


def _line(key: str, value: str) -> str:
    return tomli_w.dumps({key: value}).rstrip("\n")
