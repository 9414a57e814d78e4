"""Setup and inspection: `init` writes a job, a robot folder or a log, `doctor` checks one, `view` shows a result."""

from __future__ import annotations

import math
import shutil
import time
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import tomli_w

from compplan.cli.options import INPUT, CommandResult, Number, add_options, make_command, robot_option
from compplan.cli.terminal import show, show_progress
from compplan.controllers.writers import WRITERS, list_languages
from compplan.controllers.writers.joint_convention import load_controller
from compplan.controllers.writers.post import read_post
from compplan.errors import CompplanError, InputError, UnknownNameError
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_text
from compplan.io.transaction import replace_folder
from compplan.robot import Robot, load_robot, read_robot_folder
from compplan.robot.brands import CONTROLLERS
from compplan.robot.folder_template import TURNS, build_skeleton
from compplan.robot.rating import Rating
from compplan.toolpath.readers import find_reader, list_suffixes

if TYPE_CHECKING:
    from compplan.cli.doctor import Remark

#: Forms of `init` by the first word: usage, and allowed options; any other first word is the file of a job.
FORMS = {
    "robot": ("robot URDF", ("tcp", "tool_axis", "controller", "payload", "reach", "mass", "out")),
    "template": ("template LANGUAGE", ("out",)),
    "profile": ("profile --robot ROBOT", ("robot_name", "out")),
    "log": ("log --robot ROBOT", ("robot_name", "out")),
    "schema": ("--schema", ("schema",)),
    "job": ("FILE", ("robot_name", "toolpath", "short")),
}


@click.command()
@click.argument("words", nargs=-1, metavar="[FILE | profile | robot URDF | log | template LANGUAGE]")
@add_options(
    robot_option("Robot of the job, or of the log: folder or shipped robot.", required=False),
    click.option("--toolpath", help="Toolpath of the job, relative to it: CSV or a CAM file."),
    click.option("--tcp", help="init robot: frame of the tool centre point; left out: the end of the chain."),
    click.option("--tool-axis", type=click.Choice(list(TURNS)),
                 help="init robot: axis of that frame that points out of the tool."),
    click.option("--controller", type=click.Choice(list(CONTROLLERS)),
                 help="init robot: take its joint names, signs, configuration words, pendant frame."),
    click.option("--payload", type=Number(0.1, 3000.0),
                 help="init robot: rated payload in kg; with --reach it gives springs by a rule (assumed)."),
    click.option("--reach", type=Number(0.2, 10.0), help="init robot: reach in m."),
    click.option("--mass", type=Number(1.0, 2e4),
                 help="init robot: own weight in kg, which checks the masses of the URDF."),
    click.option("--short", is_flag=True, help="Write only the main keys of a job."),
    click.option("--out", type=INPUT, help="Folder of the robot, or file of the log or template."),
    click.option("--schema", is_flag=True, help="Print the JSON schema of a job, and write nothing."),
)  # fmt: skip
def run_init(words: tuple[str, ...], **options: Any) -> None:
    """Write a job FILE (default job.toml) in which every key is explained; a shop profile; a robot folder; a log.

    With --robot the job has a place of the part within reach, a straight tool and forces that the arm can hold, all
    assumed.

    Example: compplan init part.toml --robot ur10 --toolpath part.nc

    Example: compplan init robot arm.xacro --controller krc4 --payload 16 --reach 1.61 --out arm

    Example: compplan init template krl --out cell.src.jinja

    Example: compplan init profile --robot kuka_kr240 --out shop.toml

    Example: compplan init --schema

    Example: compplan init log --robot arm --out measurements.csv
    """
    form = _check_form(words, options)
    out, robot_name = options["out"], options["robot_name"]
    if form == "schema":
        from compplan.job.job import write_schema

        lines = [write_schema()]
    elif form == "job":
        file = Path(words[0]) if words else Path("job.toml")
        lines = _init_job(file, robot_name, options["toolpath"], short=options["short"])
    elif form == "robot":
        lines = _init_robot(Path(words[1]), options, out)
    elif form == "template":
        language = words[1]
        if language not in WRITERS:
            raise UnknownNameError("program language", language, list(WRITERS))
        file = _write_new(out or Path(f"{language}.jinja"), read_post(language))
        lines = [f'wrote {file}; next: [output] templates = {{ {language} = "{file.name}" }}']
    elif form == "profile":
        from compplan.job.profile import write_profile_text

        file = out or Path("shop.toml")
        robot = None if robot_name is None else load_robot(robot_name, relative_to=file.parent)
        language = "csv" if robot is None else _native_language(robot)
        _write_new(file, write_profile_text(robot_name or "kuka_kr210_r2700_2", language))
        lines = [f'wrote {file}; next: profile = "{file.name}" in a job, or compplan post CAMFILE --profile {file}']
    elif robot_name is None:
        raise InputError("init log needs --robot: its joints are columns")
    else:
        from compplan.measurement.reading import write_log_text

        file = _write_new(out or Path("measurements.csv"), write_log_text(load_robot(robot_name)))
        lines = [f"wrote {file}; next, when it is filled in: compplan doctor {file} --robot {robot_name}"]
    show({}, False, lines)


def _check_form(words: tuple[str, ...], options: Mapping[str, Any]) -> str:
    """Return the form of `init`; refuse a wrong number of words, and options of another form."""
    form = "schema" if options["schema"] else words[0] if words and words[0] in FORMS else "job"
    usage, own = FORMS[form]
    if form == "schema" and words:
        raise InputError(f"{words[0]!r} has no meaning in: compplan init --schema")
    if form == "job" and len(words) > 1:
        forms = "'profile', 'robot URDF', 'log' or 'template LANGUAGE'"
        raise InputError(f"init takes one FILE, {forms}, not {' '.join(words)!r}")
    wanted = 1 + (form in ("robot", "template"))
    if form not in ("job", "schema") and len(words) != wanted:
        raise InputError(f"{len(words) - 1} words after {words[0]!r}, expected: compplan init {usage}")
    for name, value in options.items():
        if value and name not in own:
            option = name.removesuffix("_name").replace("_", "-")
            raise InputError(f"--{option} has no meaning in: compplan init {usage}")
    return form


def _init_job(file: Path, robot_name: str | None, toolpath: str | None, *, short: bool) -> list[str]:
    from compplan.job.commented_job import describe_mount, read_called_tools, shorten_job, write_job_text

    _refuse_existing(file)
    if file.suffix.lower() != ".toml":
        raise InputError(f"a job is a file that ends in .toml, not {str(file)!r}")
    words, place, assumed = dict[str, Any](), "", ""
    cam = toolpath is not None and not toolpath.lower().endswith(".csv")
    robot = None if robot_name is None else load_robot(robot_name, relative_to=file.parent)
    if robot is not None:
        words |= {"robot": robot_name, "language": _native_language(robot), "tool": describe_mount(robot, used=cam)}
    if toolpath is not None:
        _check_toolpath(file.parent / toolpath, file.name)
        line = tomli_w.dumps({"toolpath": toolpath}).rstrip("\n")
        words |= {"toolpath": line, "model": "milling" if cam else "columns", "assumed": cam}
        if cam:
            try:
                tools = read_called_tools(file.parent / toolpath)
                if len(tools) != 1:
                    words["tools"] = tools
                else:
                    words |= {"model": "", "cut": tools[0].cut} if tools[0].drills else tools[0].cut
                assumed = "assumed values, replace them by yours: tool length and mass, the numbers of the cut"
            except CompplanError as error:
                assumed = f"tools and spindle speeds are not taken from {toolpath}: {error}"
    text = write_job_text(**words)
    if robot is not None:
        with show_progress() as announce:
            announce("place of the part")
            found, place = _place_part(text, file)
        words |= found | (_ease_force(text, robot) if toolpath is None else {})
        text = write_job_text(**words)
    write_text(file, shorten_job(text) if short else text)
    return [*filter(None, (place, assumed)), f"wrote {file}; next: compplan plan {file} --out out"]


def _place_part(text: str, file: Path) -> tuple[dict[str, Any], str]:
    """Find a place of the part where the arm reaches the path; return the template words of the place, and a message.

    For a toolpath that cannot be read with the settings of the text, the part keeps its default place.
    """
    from compplan.job.job import check_job
    from compplan.job.operations import split_job
    from compplan.planning.plan import job_robot
    from compplan.planning.posture.place import find_first_place

    try:
        job = split_job(check_job(tomllib.loads(text), file))[0]
        found = find_first_place(job, job_robot(job))
    except CompplanError as error:
        return {}, f"the part has the default place, its path was not tried ({error})"
    if found is None:
        return {}, "no place was found at which this robot reaches the whole path; choose a larger robot"
    position = [round(1e3 * float(value), 1) + 0.0 for value in found[0]]
    why = "amid the places within reach" if found[1] else "in front of the arm, not tried"
    return {"place": f"{position}  # assumed: {why}; put yours"}, f"the part is at {position} mm (assumed: {why})"


def _ease_force(text: str, robot: Robot) -> dict[str, Any]:
    """Return the template words of a force that is half of what the strongest joint holds with the arm stretched."""
    process, most = tomllib.loads(text)["process"], float(robot.effort_limits[~robot.prismatic].max(initial=0.0))
    share = 0.5 * most / robot.longest_reach / process["axial_N"]
    if not 0.0 < share < 1.0:
        return {}
    eased = {}
    for key in ("axial_N", "lateral_N"):  # rounded down to two digits
        value = share * process[key]
        step = 10.0 ** (math.floor(math.log10(value)) - 1)
        eased[key] = round(math.floor(value / step) * step, 6)
    return {**eased, "eased": "assumed: half of what this arm can hold when stretched; put yours; "}


def _check_toolpath(path: Path, job: str) -> None:
    """Refuse a file that is not a toolpath; a CAM file is not read, because it may need settings of the job."""
    from compplan.toolpath.readers.lines import read_bounded

    if not path.is_file():
        raise InputError(f"no such file; --toolpath counts from the folder of {job}", file=path)
    if path.suffix.lower() not in (".csv", *list_suffixes()) and find_reader(path, read_bounded(path)) is None:
        raise InputError(
            f"is not a toolpath, expected a file that ends in .csv, {', '.join(list_suffixes())}", file=path
        )


def _init_robot(urdf: Path, options: Mapping[str, Any], out: Path | None) -> list[str]:
    """Write a robot folder and report its contents, omissions and missing data."""
    payload, reach, mass = (options[name] for name in ("payload", "reach", "mass"))
    if (payload is None) != (reach is None) or (mass is not None and payload is None):
        raise InputError("--payload, --reach and --mass: give payload and reach together, own weight beside them")
    rating, controller = None if payload is None else Rating(payload, reach, mass), options["controller"]
    folder = out or Path(urdf.stem)
    if not folder.is_dir() or any(folder.iterdir()):  # an interrupted run may have left it empty
        _refuse_existing(folder)
    made = build_skeleton(urdf, options["tcp"], options["tool_axis"], controller, rating)
    with replace_folder(folder, "init") as new:
        for name, text in made.texts.items():
            write_text(new / name, text)
        for place, source in made.meshes.items():
            (new / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, new / place)
        read_robot_folder(new)
    lines = ["springs: none, the robot is rigid; --payload and --reach estimate those of six rotating joints"]
    if made.springs:
        lines = [f"springs: {made.springs}, assumed by payload and reach (grade {made.grade})"]
    if made.mass_fault:
        lines.append(f"masses: {made.mass_fault}; the masses are left out, correct the URDF and run init again")
    if made.missing:
        lines.append(f"meshes: {len(made.meshes)} copied, {len(made.missing)} not found ({made.missing[0]})")
    if made.gaps:
        lines.append(f"Cartesian programs lack {'; '.join(made.gaps)}")
    if controller is not None:
        lines.append("controller.toml is derived from the geometry and not checked: compare two postures with the "
                     "display, then set checked = true")  # fmt: skip
    return [*lines, f"wrote {folder}; next: compplan doctor {folder}"]


def _native_language(robot: Robot) -> str:
    """Return the native language of the robot's controller, a table if none is known."""
    languages = list_languages(load_controller(robot).name)
    return languages[0] if len(languages) < len(WRITERS) else "csv"


def _write_new(file: Path, text: str) -> Path:
    write_text(_refuse_existing(file), text)
    return file


def _refuse_existing(path: Path) -> Path:
    if path.exists():
        raise InputError("exists already; name another", file=path)
    return path


#: Terminal colours of the states.
COLOURS = {"fine": "green", "note": "cyan", "odd": "yellow", "do": "cyan"}


@make_command(
    click.argument("target", required=False),
    robot_option("Robot that the log was taken on: folder or shipped robot.", required=False),
)
def run_doctor(target: str | None, robot_name: str | None) -> CommandResult:
    """Check TARGET, a robot (folder or name) or a measurement log, and list what is odd; without it, the installation.

    Example: compplan doctor measurements.csv --robot ur10
    """
    from compplan.cli.doctor import examine_installation, examine_log, examine_robot

    _refuse_others(target)
    if target is not None and Path(target).is_file():
        findings = examine_log(Path(target), None if robot_name is None else load_robot(robot_name))
    elif target is not None and Path(target).suffix.lower() == ".csv":
        raise InputError("measurement log not found", file=Path(target))
    elif target is not None and robot_name is not None:
        raise InputError(f"--robot is the robot of a log, but {target!r} is not a log: name one robot")
    elif target is not None or robot_name is not None:
        findings = examine_robot(load_robot(target if target is not None else str(robot_name)))
    else:
        findings = examine_installation()
    summary = {"findings": [asdict(finding) for finding in findings], "made_by": describe_origin()}
    return CommandResult(summary, _describe_findings(findings))


def _refuse_others(target: str | None) -> None:
    """Refuse the input of another command, with the name of that command."""
    if target is None or Path(target).is_dir():
        return
    suffix = Path(target).suffix.lower()
    if suffix == ".toml":
        sentence = f"is neither a robot folder nor a log; if it is a job: compplan plan {target} --out out"
        raise InputError(sentence, file=target)
    if suffix in list_suffixes():
        sentence = f"is a CAM file; compplan convert {target} --out path.csv writes its toolpath, "
        raise InputError(
            f"{sentence}compplan init job.toml --robot ROBOT --toolpath {target} a job for it", file=target
        )


def _describe_findings(findings: list[Remark]) -> list[str]:
    """Return the findings as lines of text."""
    width = max(len(finding.about) for finding in findings)
    lines = []
    for finding in findings:
        text = finding.sentence + (f"; {finding.advice}" if finding.advice else "")
        state = click.style(f"{finding.state:<4}", fg=COLOURS[finding.state])
        lines.append(f"{state}  {finding.about:<{width}}  {text}")
    odd, notes = (sum(finding.state == state for finding in findings) for state in ("odd", "note"))
    count = f"{len(findings)} checks: {odd or 'nothing'} odd, {notes} note{'s' * (notes != 1)}"
    return [*lines, count]


@click.command()
@click.argument("out", type=INPUT)
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="Port on 127.0.0.1.")
@click.option("--open/--no-open", "opened", default=True, help="Open the page in the browser.")
def run_view(out: Path, port: int, opened: bool) -> None:
    """Show OUT, a folder of compplan plan or post: the arm along the path.

    A plan of several tools has a folder for each: compplan view out/T1. Ctrl-C ends it.

    Example: compplan view out
    """
    from compplan.reporting.view.server import HOST, start_server

    with show_progress() as progress:
        progress("the viewer starts")
        viewer = start_server(out, port)
    address = f"http://{HOST}:{port}"
    show({}, False, [f"{out} at {address}, Ctrl-C ends it"])
    if opened:
        click.launch(address)
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt:
        viewer.stop()
