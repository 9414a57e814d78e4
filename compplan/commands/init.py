"""`compplan init`: write a commented job, a robot folder from a URDF, or an empty measurement log."""

from __future__ import annotations

import re
from pathlib import Path

import click
import tomli_w

from compplan.commands.completion import complete_robots
from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.files.transaction import replace_folder
from compplan.job.text import write_job_text
from compplan.measure.skeleton import write_log_text
from compplan.path.cam import list_suffixes
from compplan.path.reading import read_toolpath
from compplan.program import WRITERS, list_languages
from compplan.program.counting import load_controller
from compplan.robot import Robot, load_robot
from compplan.robot.skeleton import write_skeleton

#: Keys of a force model that stay out until somebody wants them.
OPTIONAL = ("# required", "# stock_top_mm")
#: Stands for the feed that the job may state, while a toolpath is only looked at. [m/s]
ANY_FEED = 0.01


@click.command()
@click.argument("words", nargs=-1, metavar="[FILE | robot URDF | log]")
@click.option("--robot", "robot_name", default=None, shell_complete=complete_robots,
              help="Robot of the job, or of the log: folder or shipped robot.")  # fmt: skip
@click.option("--toolpath", default=None, help="Toolpath of the job, relative to it: CSV or a CAM file.")
@click.option("--tcp", default=None, help="init robot: frame of the tool centre point; left out: the end of the chain.")
@click.option("--out", type=click.Path(path_type=Path), default=None, help="Folder of the robot, or file of the log.")
def command(
    words: tuple[str, ...], robot_name: str | None, toolpath: str | None, tcp: str | None, out: Path | None
) -> None:
    """Write a job FILE (default job.toml) in which every key is explained; or a robot folder; or an empty log.

    Example: compplan init part.toml --robot ur10 --toolpath part.nc

    Example: compplan init robot arm.urdf --out arm

    Example: compplan init log --robot arm --out measurements.csv
    """
    if words[:1] == ("robot",):
        _refuse(words, 2, "robot URDF", robot_name=robot_name, toolpath=toolpath)
        _init_robot(Path(words[1]), tcp, out)
    elif words[:1] == ("log",):
        _refuse(words, 1, "log --robot ROBOT", toolpath=toolpath, tcp=tcp)
        _init_log(robot_name, out or Path("measurements.csv"))
    else:
        if len(words) > 1:
            raise InputError(f"init takes one FILE, 'robot URDF' or 'log', not {' '.join(words)!r}")
        _refuse(words, len(words), "FILE", tcp=tcp, out=out)
        _init_job(Path(words[0]) if words else Path("job.toml"), robot_name, toolpath)


def _refuse(words: tuple[str, ...], count: int, form: str, **options: object) -> None:
    """Refuse words that are too few or too many, and options of another form."""
    if len(words) != count:
        raise InputError(f"{len(words) - 1} words after {words[0]!r}, expected: compplan init {form}")
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.removesuffix('_name')} has no meaning in: compplan init {form}")


def _init_job(file: Path, robot_name: str | None, toolpath: str | None) -> None:
    _refuse_existing(file)
    if file.suffix.lower() != ".toml":
        raise InputError(f"a job is a file that ends in .toml, not {str(file)!r}")
    text = write_job_text()
    if robot_name is not None:
        robot = load_robot(robot_name, relative_to=file.parent)
        text = text.replace('robot = "staubli_tx200" ', f"{_line('robot', robot_name)} ", 1)
        text = text.replace('programs = ["val3"]', f'programs = ["{_native_language(robot)}"]', 1)
    if toolpath is not None:
        _check_toolpath(file.parent / toolpath)
        line = _line("toolpath", toolpath) + "\n\n"
        text = re.sub(r'# toolpath = "part.nc"\n.*?\n(?=\[part\])', lambda _: line, text, count=1, flags=re.DOTALL)
        text = _choose_process(text, "columns" if toolpath.lower().endswith(".csv") else "milling")
    write_text(file, text)
    click.echo(f"wrote {file}; next: compplan plan {file} --out out")


def _choose_process(text: str, model: str) -> str:
    """Let a force model that suits the toolpath stand in place of sheet forming: its lines, and no other model's."""
    head, process, rest = re.split(r"(?<=\n)(\[process\].*?\n)(?=\n)", text, maxsplit=1, flags=re.DOTALL)
    lines = [line if line.startswith(("#", "[")) else f"# {line}" for line in process.splitlines()]
    first = next(k for k, line in enumerate(lines) if line.startswith(f'# model = "{model}"'))
    last = next(k for k, line in enumerate(lines) if k > first and line.startswith("# model = "))
    own = [line.removeprefix("# ") for line in lines[first:last] if not line.startswith(OPTIONAL)]
    left = [line for k, line in enumerate(lines) if not first <= k < last or line.startswith(OPTIONAL)]
    note = "# the numbers of the cut are assumed: put yours" if model == "milling" else ""
    return head + "\n".join([left[0], *filter(None, [note]), *own, *left[1:]]) + "\n" + rest


def _check_toolpath(path: Path) -> None:
    """Refuse what is no toolpath; a CAM file is not read, for it may need what the job says of it."""
    if not path.is_file():
        raise InputError("no such toolpath (it counts from the folder of the job)", file=path)
    if path.suffix.lower() == ".csv":
        read_toolpath(path, feed=ANY_FEED)
    elif path.suffix.lower() not in list_suffixes():
        raise InputError(f"is no toolpath, expected a file that ends in .csv, {', '.join(list_suffixes())}", file=path)


def _init_robot(urdf: Path, tcp: str | None, out: Path | None) -> None:
    folder = out or Path(urdf.stem)
    if not folder.is_dir() or any(folder.iterdir()):  # a run that died may have left it empty
        _refuse_existing(folder)
    texts = write_skeleton(urdf, tcp)
    with replace_folder(folder, "init") as new:
        for name, text in texts.items():
            write_text(new / name, text)
    click.echo(f"wrote {folder}; next: compplan doctor {folder}")


def _init_log(robot_name: str | None, file: Path) -> None:
    if robot_name is None:
        raise InputError("init log needs --robot: its joints are columns")
    _refuse_existing(file)
    write_text(file, write_log_text(load_robot(robot_name)))
    click.echo(f"wrote {file}; next, when it is filled in: compplan doctor {file} --robot {robot_name}")


def _native_language(robot: Robot) -> str:
    """Return the language that the robot's own controller speaks, a table where none is known."""
    spoken = list_languages(load_controller(robot).name)
    return spoken[0] if len(spoken) < len(WRITERS) else "csv"


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise InputError("exists already; name another", file=path)


def _line(key: str, value: str) -> str:
    return tomli_w.dumps({key: value}).rstrip("\n")
