"""Inputs of the API functions: a job (a file, a job, its sections, or a path with a robot) and a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tomlfile import check_table, read_named_table, read_toml
from compplan.job.job import Job, ToolTable, check_job
from compplan.job.profile import read_profile
from compplan.robot import Robot, load_robot
from compplan.robot.folder import find_robot_folder
from compplan.toolpath.reading import read_toolpath
from compplan.toolpath.toolpath import Toolpath

#: A section of a job: its keys, or a TOML file with them (alone, or within a job).
Table = Mapping[str, Any] | str | Path
#: Sections of a job that API functions accept as keywords: all except `NO_TABLES`.
NO_TABLES = ("schema_", "name", "profile", "robot", "toolpath")
TABLES = tuple(field.alias or name for name, field in Job.model_fields.items() if name not in NO_TABLES)
#: Name of a path in memory, in its job.
IN_MEMORY = "path in memory"
#: Force model of a path without a force.
NO_FORCE: dict[str, Any] = {"model": "constant", "force_N": [0.0, 0.0, 0.0]}
#: Force model of a path table, which may hold the force.
PERHAPS_COLUMNS: dict[str, Any] = {"model": "columns", "required": False}


def make_job(source: Any, robot: Any = None, tables: Mapping[str, Any] | None = None) -> Job:
    """Make a job from the arguments of an API function.

    Args:
        source: A job: the file, a `Job`, its sections; or a path: a CAM file or CSV, a `Toolpath`, a DataFrame, or
            columns by name.
        robot: The robot: name of a shipped one, folder, or `Robot`; it replaces the job's, and is required for a path.
        tables: Sections of the job (`TABLES`); their keys replace those of the job. A part may be X, Y, Z, or X, Y, Z,
            RX, RY, RZ, in mm and deg.

    Raises:
        InputError: If an argument is not valid, or a path has no robot or no part frame.
    """
    if isinstance(source, Job) and robot is None and not tables:
        return source
    given = tables or {}
    if unknown := [name for name in given if name not in TABLES]:
        raise InputError(f"no section named {unknown[0]!r} in a job, choose from {list(TABLES)}")
    more = {name: read_table(name, table) for name, table in given.items() if table is not None}
    if "part" in more and not isinstance(given["part"], Mapping | str | Path):
        more["part"] = {"rotation_deg": [0.0, 0.0, 0.0], **more["part"]}
    data, file, toolpath, mounted, is_path = _read_source(source)
    if robot is not None:
        mounted = robot if isinstance(robot, Robot) else None
        data["robot"] = robot.name if mounted is not None else str(find_robot_folder(str(robot)).resolve())
    if "robot" not in data:
        raise InputError("a path needs a robot: robot = the name of a shipped robot, a folder, or a Robot")
    if is_path and "part" not in more:
        raise InputError(
            "a path needs a part frame: part = (X, Y, Z) or (X, Y, Z, RX, RY, RZ) in mm and deg, seen from the robot "
            "base; (0, 0, 0) for a path whose coordinates count from the base"
        )
    for name, table in more.items():
        old = data.get(name)
        other = name == "process" and table.get("model", "") not in ("", _plain(old).get("model"))
        data[name] = {**_plain(old), **table} if isinstance(table, Mapping) and not other else table
    return check_job(data, file, toolpath=toolpath, robot=mounted)


def _read_source(source: Any) -> tuple[dict[str, Any], Path, Toolpath | None, Robot | None, bool]:
    """Return sections and file of the job, path and robot in memory, and whether it is a path without a job."""
    if isinstance(source, Job):
        tables = source.model_dump(exclude_unset=True, by_alias=True)
        numbered = {"tool": source.context.data["tool"]} if source.context.tools else {}
        return {**tables, **numbered}, source.file, source.context.given, source.context.mounted, False
    if isinstance(source, str | Path) and Path(source).suffix.lower() == ".toml":
        return read_toml(source), Path(source), None, None, False
    if isinstance(source, Mapping) and "toolpath" in source:
        return dict(source), Path("job.toml").absolute(), None, None, False
    if isinstance(source, str | Path):
        file = Path(source).absolute()
        force = PERHAPS_COLUMNS if file.suffix.lower() == ".csv" else NO_FORCE
        return _path_job(file.stem, str(file), force), file.with_suffix(".toml"), None, None, True
    toolpath = read_toolpath(source)
    if toolpath.frame != "part":
        raise InputError(f"the toolpath is in the {toolpath.frame} frame, expected the part frame")
    name = Path(toolpath.source).stem or IN_MEMORY
    name = IN_MEMORY if name.startswith("<") else name
    force = NO_FORCE if toolpath.wrench is None else {"model": "columns"}
    tables = _path_job(name, IN_MEMORY, force)
    return tables, Path("job.toml").absolute(), replace(toolpath, source=""), None, True


def _path_job(name: str, toolpath: str, process: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a job for a path without one."""
    return {"schema": 1, "name": name, "toolpath": toolpath, "process": dict(process)}


def read_table(name: str, table: Any) -> Any:
    """Return a section of a job from its keys, from a TOML file, or from a short form.

    Short forms are numbers for a part, a language for [output], and a list of sections for [[tool]].

    Raises:
        InputError: If it is none of them, or the file is not valid.
    """
    if isinstance(table, Mapping):
        return dict(table)
    if name == "output" and isinstance(table, str) and not table.endswith(".toml"):
        return {"programs": [table]}
    if isinstance(table, str | Path):
        found = read_named_table(table, name)[0]
        file = found.get("file")
        return found if file is None else {**found, "file": str((Path(table).parent / str(file)).absolute())}
    if name == "part" and isinstance(table, Sequence):
        if len(table) not in (3, 6):
            expected = "expected X Y Z in mm, or six with a rotation vector in deg"
            raise InputError(f"part has {len(table)} numbers, {expected}")
        numbers = [float(value) for value in table]
        return {"position_mm": numbers[:3], **({"rotation_deg": numbers[3:]} if numbers[3:] else {})}
    if isinstance(table, Sequence) and table and all(isinstance(row, Mapping) for row in table):
        return [dict(row) for row in table]
    raise InputError(f"{name} is {table!r}, expected a section such as [{name}] of a job")


def _plain(table: Any) -> dict[str, Any]:
    return dict(table) if isinstance(table, Mapping) else {}


def load_with_tool(robot: str | Path | Robot, tool: Table | None = None) -> Robot:
    """Return a robot with its mounted tool.

    Args:
        robot: Name of a shipped robot, a robot folder, or the robot.
        tool: The tool as [tool] of a job, or its TOML file; left out: the tool of the robot folder.

    Raises:
        InputError: If there is no such robot, or the tool is not valid.
    """
    known = robot if isinstance(robot, Robot) else load_robot(robot)
    if tool is None:
        return known
    if isinstance(tool, Mapping):
        return check_table(ToolTable, tool, key="tool").mount(known)
    table, key = read_named_table(tool, "tool")
    return check_table(ToolTable, table, file=tool, key=key).mount(known)


def make_post_job(
    camfile: str | Path, *, robot: str | Path | None, part: Table | Sequence[float] | None,
    program: str | Sequence[str], profile: str | Path | None, tools: Table | Sequence[Mapping[str, Any]] | None,
    job_file: Path, **tables: Table | None,
) -> Job:  # fmt: skip
    """Make the job for a call of `post`; arguments as there, `tables`: sections by their names in a job.

    `job_file` is the path of the assumed job file; relative paths refer to its folder.

    Raises:
        InputError: If a section is not valid.
    """
    languages = [program] if isinstance(program, str) else list(program)
    under = {} if profile is None else read_profile(Path(profile))
    data: dict[str, Any] = {"schema": 1, "name": Path(camfile).stem, "toolpath": str(Path(camfile).absolute())}
    data |= {} if "process" in under else {"process": dict(NO_FORCE)}
    data |= {} if profile is None else {"profile": str(Path(profile).absolute())}
    stated = {"robot": robot, "part": part, "program": program or under.get("output", {}).get("programs")}
    for option, value in stated.items():
        if not value and option not in under:
            form = " X,Y,Z (mm)" if option == "part" else ""
            raise InputError(f"--{option}{form} is missing: give it, or state it in a shop profile (--profile FILE)")
    if robot is not None:
        find_robot_folder(robot)
        data["robot"] = str(Path(robot).absolute()) if Path(robot).is_dir() else str(robot)
    if part is not None:
        data["part"] = read_table("part", part)
    data |= {name: read_table(name, table) for name, table in tables.items() if table is not None}
    if languages:
        data["output"] = {**data.get("output", {}), "programs": [language.lower() for language in languages]}
    if tools is not None:
        key, value = read_tools(tools)
        data[key] = value
    return check_job(data, job_file)


def read_tools(tools: Table | Sequence[Mapping[str, Any]]) -> tuple[str, Any]:
    """Return key and value of the tools in a job: [[tool]] from a list or a TOML file, otherwise [tools].

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
