"""From a CAM file to native programs in one call, without a job file: what `compplan post` and `cp.post` do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tomlfile import read_named_table, read_toml
from compplan.job.job import Job, check_job
from compplan.job.operations import split_job
from compplan.job.profile import read_profile
from compplan.planning.operations import worst_status
from compplan.planning.plan import plan_job
from compplan.planning.result import Plan
from compplan.reporting.operations import deliver_operations
from compplan.reporting.writers.plan import deliver_plan, note_programs
from compplan.robot.folder import find_robot_folder

#: A table of a job: its keys, or a TOML file that holds them (alone, or as a job).
Table = Mapping[str, Any] | str | Path
#: What stands in for a force model where none is given.
NO_FORCE = {"model": "constant", "force_N": [0.0, 0.0, 0.0]}


@dataclass(frozen=True)
class Posted:
    """What came of a CAM file.

    Attributes:
        plans: One plan an operation (a tool); one in all where the file calls one tool.
        folder: Where everything was written.
        files: The files written.
    """

    plans: tuple[Plan, ...]
    folder: Path
    files: tuple[Path, ...]

    @property
    def status(self) -> str:
        """Tell "solved", "infeasible" or "not_confirmed": the worst of the plans."""
        return worst_status(self.plans)

    @property
    def notes(self) -> tuple[str, ...]:
        """What has to be known of the plans, one sentence each."""
        return tuple(dict.fromkeys(note for plan in self.plans for note in plan.notes))


def post(
    camfile: str | Path, *, robot: str | Path | None = None, part: Table | Sequence[float] | None = None,
    program: str | Sequence[str] = (), profile: str | Path | None = None, tool: Table | None = None,
    tools: Table | Sequence[Mapping[str, Any]] | None = None, process: Table | None = None,
    cam: Table | None = None, plan: Table | None = None, output: Table | None = None, out: str | Path | None = None,
) -> Posted:  # fmt: skip
    """Read a CAM file, plan it and write its programs: one plan and program for each tool that it calls.

        done = cp.post("part.nc", robot="kuka_kr240", part=[1800, 0, 700], program="krl",
                       tool={"frame": "pendant", "position_mm": [0, 0, 250]})

    Args:
        camfile: The CAM file.
        robot: A folder in robots/ or a path.
        part: Part frame seen from the robot base: X Y Z [mm], with a rotation vector [deg] if six numbers; or [part].
        program: Language, or languages.
        profile: Shop profile that stands under all of these; robot, part and program may be left out where it has them.
        tool: [tool]; left out: the robot folder's TCP.
        tools: For a file that calls several tools: a list of [[tool]], or a tool table (its file, or [tools]).
        process: [process]; left out: no force is predicted.
        cam: [cam]: how the file is read.
        plan: [plan]: strategy, tolerance, posture.
        output: [output]: signals (io), templates.
        out: Folder to write to; left out: out.

    Raises:
        InputError: If something is not what it has to be; nothing is written then.
    """
    folder = Path("out" if out is None else out)
    job = make_post_job(
        camfile, robot=robot, part=part, program=program, profile=profile, tools=tools, tool=tool, process=process,
        cam=cam, plan=plan, output=output, stands_in=folder.absolute() / f"{Path(camfile).stem}.toml",
    )  # fmt: skip
    plans = tuple(note_programs(plan_job(one)) for one in split_job(job))
    if len(plans) == 1:
        done, files = deliver_plan(plans[0], folder)
        return Posted((done,), folder, tuple(files))
    read, files = deliver_operations(plans, folder, job.name)
    return Posted(tuple(read), folder, tuple(files))


def make_post_job(
    camfile: str | Path, *, robot: str | Path | None, part: Table | Sequence[float] | None,
    program: str | Sequence[str], profile: str | Path | None, tools: Table | Sequence[Mapping[str, Any]] | None,
    stands_in: Path, **tables: Table | None,
) -> Job:  # fmt: skip
    """Make the job that a call of `post` stands for; arguments as there, `tables` by their names in a job.

    `stands_in` is the job file that nobody wrote; paths count from its folder.

    Raises:
        InputError: If a table is not what it has to be.
    """
    languages = [program] if isinstance(program, str) else list(program)
    under = {} if profile is None else read_profile(Path(profile))
    data: dict[str, Any] = {"schema": 1, "name": Path(camfile).stem, "toolpath": str(Path(camfile).absolute())}
    data |= {} if "process" in under else {"process": dict(NO_FORCE)}
    data |= {} if profile is None else {"profile": str(Path(profile).absolute())}
    stated = {"robot": robot, "part": part, "program": program or under.get("output", {}).get("programs")}
    for option, value in stated.items():
        if not value and option not in under:
            raise InputError(f"--{option} is missing, and no profile states it")
    if robot is not None:
        find_robot_folder(robot)
        data["robot"] = str(Path(robot).absolute()) if Path(robot).is_dir() else str(robot)
    if part is not None:
        data["part"] = read_part(part)
    data |= {name: read_table_of_job(name, table) for name, table in tables.items() if table is not None}
    if languages:
        data["output"] = {**data.get("output", {}), "programs": [language.lower() for language in languages]}
    if tools is not None:
        key, value = read_tools(tools)
        data[key] = value
    return check_job(data, stands_in)


def read_part(part: Table | Sequence[float]) -> dict[str, Any]:
    """Return [part] from three or six numbers, a table, or a file.

    Raises:
        InputError: If it is none of them.
    """
    if isinstance(part, Mapping | str | Path):
        return read_table_of_job("part", part)
    numbers = [float(value) for value in part]
    if len(numbers) not in (3, 6):
        raise InputError(f"part has {len(numbers)} numbers, expected X Y Z in mm, or six with a rotation vector in deg")
    return {"position_mm": numbers[:3], **({"rotation_deg": numbers[3:]} if numbers[3:] else {})}


def read_tools(tools: Table | Sequence[Mapping[str, Any]]) -> tuple[str, Any]:
    """Return the key and the value in a job of several tools: [[tool]] from a list or a TOML file, else [tools].

    Raises:
        InputError: If a TOML file has neither.
    """
    if isinstance(tools, Mapping):
        return "tools", dict(tools)
    if not isinstance(tools, str | Path):
        return "tool", [dict(entry) for entry in tools]
    if Path(tools).suffix.lower() != ".toml":
        return "tools", {"file": str(Path(tools).absolute())}
    data = read_toml(tools)
    if isinstance(data.get("tool"), list):
        return "tool", data["tool"]
    if isinstance(data.get("tools"), dict):
        table = data["tools"]
        return "tools", {**table, "file": str((Path(tools).parent / str(table.get("file", ""))).absolute())}
    raise InputError("has neither [[tool]] nor [tools]", file=tools)


def read_table_of_job(name: str, table: Table) -> dict[str, Any]:
    """Return a table of a job: as it is given, or from a TOML file, alone or in the job that it stands in.

    Raises:
        InputError: If the file is not what it has to be.
    """
    if isinstance(table, Mapping):
        return dict(table)
    found = read_named_table(table, name)[0]
    if "file" in found:
        found = {**found, "file": str((Path(table).parent / str(found["file"])).absolute())}
    return found
