"""The job: a TOML file with robot, toolpath, process and requirements.

Each section of the file is a model here. Keys carry their units; properties are SI.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, SerializeAsAny, TypeAdapter, field_validator

from compplan.errors import InputError
from compplan.io.provenance import note_input
from compplan.io.tables import Array
from compplan.io.tomlfile import Numbers, OneOf, SchemaOne, StrictTable, Vector3, Words, check_table, read_toml
from compplan.job.frames import LONGEST_PATH, PartTable, PositionerTable, ToolTable
from compplan.job.names import STRATEGIES
from compplan.job.noise import NoiseTable
from compplan.job.output import OutputTable
from compplan.job.profile import apply_profile
from compplan.job.tools import NumberedTool, ToolsTable, check_tools
from compplan.process.force_law import turns_with_travel
from compplan.process.force_models import FORCE_MODELS
from compplan.process.force_models.columns import ColumnsProcess
from compplan.process.learned_force import LearnedForce
from compplan.robot import Robot
from compplan.robot.folder import find_robot_folder
from compplan.toolpath.contact import ForceTable
from compplan.toolpath.generators import GENERATORS, CircleTable, ConeTable, SpiralTable
from compplan.toolpath.readers import list_suffixes
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.toolpath import Toolpath

#: Keys of earlier releases, by remedy.
REMOVED = Path(__file__).with_name("removed.toml")
#: Text that --set accepts without quotes.
BARE_WORD = re.compile(r"[\w./-]+")
#: Default corner rounding as a share of the tolerance.
ROUNDED = 0.25


class Configuration(StrictTable):
    """Configuration of the arm; keys left out are free, "auto" leaves all free."""

    shoulder: Literal["front", "back"] | None = None
    elbow: Literal["up", "down"] | None = None
    wrist: Literal["flip", "noflip"] | None = None


def _expand_auto(value: object) -> object:
    if value == "auto":
        return {}
    if isinstance(value, str):
        raise ValueError(f'is {value!r}, must be \'auto\' or words such as {{ shoulder = "front", elbow = "up" }}')
    return value


class PlanTable(StrictTable):
    """[plan]: strategy, tolerance and freedom of the plan."""

    strategy: Annotated[str, OneOf(STRATEGIES)] = "nlp"
    rotate_about_tool_axis: bool = True
    configuration: Annotated[Configuration, BeforeValidator(_expand_auto)] = Configuration()
    start_deg: Numbers | None = None
    max_correction_mm: float = Field(default=10.0, gt=0.0, le=1000.0)
    tolerance_mm: float = Field(default=0.1, ge=1e-6, le=100.0)
    tool_x: Vector3 = (1.0, 0.0, 0.0)
    keep: Literal["robot", "nothing"] = "robot"  #: Robot whose posture is kept: that of the job file, or none.
    inertia: bool = True

    @field_validator("tool_x")
    @classmethod
    def _check_tool_x(cls, value: Vector3) -> Vector3:
        if not np.linalg.norm(value) > 0.0:
            raise ValueError("has length 0, expected a direction")
        return value


class ToleranceTable(StrictTable):
    """[tolerance]: use of plan.tolerance_mm.

    tube: Share of the tolerance by which a plan may leave the path for a shorter run or a narrower band.
    """

    tube: float = Field(default=0.0, ge=0.0, le=0.9)


class SamplingTable(StrictTable):
    """[sampling]: division of moves before planning (toolpath files: 1 mm by default).

    chord_mm: greatest deviation of the loaded tip between waypoints; the plan divides moves until it holds (default: a
        tenth of the tolerance).
    """

    max_step_mm: float | None = Field(default=None, gt=0.0, le=1e5)
    chord_mm: float | None = Field(default=None, gt=0.0, le=100.0)


class FeedTable(StrictTable):
    """[feed]: feed of cutting moves in place of the toolpath's, corners, torque limits."""

    constant_mm_s: float | None = Field(default=None, gt=0.0)
    mode: Literal["programmed", "constant"] = "programmed"
    corner_tolerance_mm: float | None = Field(default=None, ge=0.0, le=100.0)
    torque_limits: bool = False


class LimitsTable(StrictTable):
    """[limits]: shares of the robot's rate limits."""

    velocity_scale: float = Field(default=1.0, ge=1e-3, le=1.0)
    acceleration_scale: float = Field(default=1.0, ge=1e-3, le=1.0)


class PostureTable(StrictTable):
    """[posture]: objective of the redundant degree of freedom, and freedom of the tool axis."""

    preset: Literal["accurate", "error_band", "smooth", "fast"] = "accurate"
    lead_deg: float = Field(default=0.0, ge=0.0, le=90.0)
    lean_deg: float = Field(default=0.0, ge=0.0, le=90.0)
    limit_margin_deg: float = Field(default=10.0, gt=0.0, le=180.0)


def _ascend(limits: tuple[float, float]) -> tuple[float, float]:
    """Refuse a range in falling order."""
    if limits[1] < limits[0]:
        raise ValueError(f"ends at {limits[1]:g} before it begins at {limits[0]:g}")
    return limits


Range = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_ascend)]


class PlaceTable(StrictTable):
    """[place]: range of `compplan place` in the robot base (default: around the place of the job)."""

    x_mm: Range | None = None
    y_mm: Range | None = None
    z_mm: Range | None = None
    step_mm: float = Field(default=100.0, gt=0.0)
    turn_deg: Annotated[tuple[Annotated[float, Field(ge=-360.0, le=360.0)], ...], Field(strict=False, min_length=1)] = (
        0.0,
    )


class CollisionTable(StrictTable):
    """[collision]: meshes (relative to the job file) that the arm keeps clear of."""

    part: str | None = None
    fixture: str | None = None
    tool: str | None = None
    unit: Literal["mm", "m", "inch"] = "mm"
    clearance_mm: float = Field(default=5.0, ge=0.0, le=1e4)
    tip_zone_mm: float = Field(default=30.0, ge=0.0, le=1e4)
    without_shapes: Words = ()


@dataclass(frozen=True)
class JobContext:
    """Data of a job in addition to its sections."""

    file: Path = Path()  #: The job file.
    own_robot: str | None = None  #: Robot of the job file if another one replaces it, or None.
    given: Toolpath | None = None  #: The toolpath in memory, part frame, or None.
    mounted: Robot | None = None  #: The robot in memory, or None.
    tools: tuple[NumberedTool, ...] = ()  #: [[tool]]: the numbered tools.
    data: dict[str, Any] = field(default_factory=dict)  #: The sections of the file.
    label: str = ""  #: Short name of its operation in a CAM file of several tools.
    before: tuple[Job, ...] = ()  #: The jobs of earlier operations with described tools, in order.
    #: The force learned from parts; None: as in the robot folder.
    force: tuple[LearnedForce | None] | None = None


class Job(StrictTable):
    """A job; `load_job` reads it, `load_nominal` its toolpath."""

    schema_: SchemaOne = Field(alias="schema")
    name: str = Field(default="", max_length=200)
    profile: str | None = None
    robot: str = Field(max_length=LONGEST_PATH)
    toolpath: Annotated[str, Field(max_length=LONGEST_PATH)] | CircleTable | SpiralTable | ConeTable
    part: PartTable = PartTable.model_construct()
    positioner: PositionerTable = PositionerTable.model_construct()
    tool: ToolTable | None = None
    tool_table: ToolsTable | None = Field(default=None, alias="tools")
    process: SerializeAsAny[ForceTable] = ColumnsProcess.model_construct()
    plan: PlanTable = PlanTable.model_construct()
    tolerance: ToleranceTable = ToleranceTable.model_construct()
    output: OutputTable = OutputTable.model_construct()
    sampling: SamplingTable = SamplingTable.model_construct()
    cam: CamTable = CamTable.model_construct()
    feed: FeedTable = FeedTable.model_construct()
    limits: LimitsTable = LimitsTable.model_construct()
    posture: PostureTable = PostureTable.model_construct()
    place: PlaceTable = PlaceTable.model_construct()
    noise: NoiseTable = NoiseTable.model_construct()
    collision: CollisionTable | None = None
    _context: JobContext = PrivateAttr(default_factory=lambda: JobContext())

    @field_validator("robot")
    @classmethod
    def _check_robot(cls, value: str) -> str:
        if not value.strip():
            raise ValueError("is empty, expected a folder in robots/ or a path")
        return value

    @property
    def context(self) -> JobContext:
        """Data of the job in addition to its sections."""
        return self._context

    def with_context(self, **changes: Any) -> Job:
        """Return the job with some of its context changed."""
        job = self.model_copy()
        job._context = replace(self._context, **changes)
        return job

    @property
    def file(self) -> Path:
        """The job file."""
        return self._context.file

    @property
    def folder(self) -> Path:
        """The folder of the job file; file names in the job are relative to it."""
        return self._context.file.parent

    @property
    def corner_tolerance(self) -> float:
        """Rounding of corners: as stated, otherwise a share of the tolerance for files. [m]

        With constant feed and a force that turns with the feed direction the default is 0: the correction would jump.
        """
        if self.feed.corner_tolerance_mm is not None:
            return 1e-3 * self.feed.corner_tolerance_mm
        jumps = self.feed.mode == "constant" and turns_with_travel(self.process)
        rounds = self._context.given is None and isinstance(self.toolpath, str) and not jumps
        return ROUNDED * 1e-3 * self.plan.tolerance_mm * rounds

    @property
    def label(self) -> str:
        """Short name of this job's operation if its CAM file has several tools, otherwise ""."""
        return self._context.label

    @property
    def T_base_part(self) -> Array:
        """Pose of the part frame in the robot base. Shape (4, 4) [m]."""
        return self.part.pose

    @property
    def tool_x_base(self) -> Array:
        """The TCP frame's x axis in base axes (key plan.tool_x), for a tool that may not turn about its axis. (3,)."""
        direction = self.T_base_part[:3, :3] @ np.asarray(self.plan.tool_x)
        return np.asarray(direction / np.linalg.norm(direction))


def check_job(
    data: dict[str, Any], file: str | Path = Path(), *, toolpath: Toolpath | None = None, robot: Robot | None = None
) -> Job:
    """Check a job given as sections.

    Args:
        data: The sections from `tomllib`.
        file: Their file, for messages and relative paths.
        toolpath: A toolpath in memory in place of the file.
        robot: A robot in memory in place of the folder.

    Raises:
        InputError: With file and key.
    """
    plain = data = apply_profile(data, file)
    _refuse_removed(data, file)
    data = dict(data)
    tools: tuple[NumberedTool, ...] = ()
    if isinstance(data.get("tool"), list):
        if "tools" in data:
            raise InputError("is given beside [tools], expected one of them", file=file, where="tool")
        tools = check_tools(data["tool"], file)
        data = {key: value for key, value in data.items() if key != "tool"}
    table, process = data.get("toolpath"), data.get("process")
    if isinstance(table, dict):
        kind = _choose(table, "toolpath.generator", GENERATORS, file)
        data["toolpath"] = check_table(GENERATORS[kind], table, file=file, key="toolpath")
    elif table is not None and not isinstance(table, str):
        raise InputError(f"is {table!r}, must be a file or a section with a generator", file=file, where="toolpath")
    if isinstance(process, dict):
        model = _choose(process, "process.model", FORCE_MODELS, file)
        data["process"] = check_table(FORCE_MODELS[model].table, process, file=file, key="process")
    job = check_table(Job, data, file=file)
    level = getattr(job.process, "uncertainty", None)
    if level is not None and "wrench_level" not in job.noise.model_fields_set:
        noise = job.noise.model_copy(update={"wrench_level": level})
        noise.model_fields_set.discard("wrench_level")  # set by the model, not by the job
        job = job.model_copy(update={"noise": noise})
    return job.with_context(file=Path(file), given=toolpath, mounted=robot, tools=tools, data=plain)


def _choose(table: dict[str, Any], where: str, names: Collection[str], file: str | Path) -> str:
    """Return the name that a section gives for its kind, at a dotted key; refuse a missing or an unknown one."""
    name = table.get(where.rpartition(".")[2])
    if not isinstance(name, str) or name not in names:
        fault = "missing key" if name is None else f"is {name!r}"
        raise InputError(f"{fault}, choose from {list(names)}", file=file, where=where)
    return name


def _refuse_removed(data: dict[str, Any], file: str | Path) -> None:
    """Refuse a job that holds a key of an earlier release, with a remedy."""
    for advice, keys in tomllib.loads(REMOVED.read_text(encoding="utf-8")).items():
        for key in keys:
            if _holds_key(data, key.split(".")):
                name = re.sub(":[a-z_]+", "", key) if "." in key else f"[{key}]"
                raise InputError(f"{name} is no longer supported; {advice}", file=file, where=name.strip("[]"))


def _holds_key(table: Any, key: list[str]) -> bool:
    """Return whether a section, or one of several, holds a dotted key; "process:drill" holds for this model alone."""
    if isinstance(table, list):
        return any(_holds_key(entry, key) for entry in table)
    name, _, model = key[0].partition(":")
    if not isinstance(table, dict) or name not in table:
        return False
    inner = table[name]
    wanted = not model or (isinstance(inner, dict) and inner.get("model") == model)
    return wanted and (len(key) == 1 or _holds_key(inner, key[1:]))


def load_job(path: str | Path, robot: str | None = None, changes: Sequence[str] = ()) -> Job:
    """Read a job file.

    Args:
        path: The file.
        robot: Robot folder or shipped robot in place of the job's; relative to the working directory.
        changes: Keys in place of the file's, such as "plan.tolerance_mm=0.05" (--set).

    Raises:
        InputError: With file and line or key, if it is invalid.
    """
    suffix = Path(path).suffix.lower()
    if suffix != ".toml" and suffix in list_suffixes():
        hint = "compplan init JOB.toml --robot ROBOT --toolpath FILE writes one, compplan post takes the file itself"
        raise InputError(f"is a CAM file, expected a job that ends in .toml; {hint}", file=path)
    if suffix == ".csv":
        raise InputError("is a table, expected a job that ends in .toml", file=path)
    data = read_toml(path)
    changed = [_change_key(data, change) for change in changes]
    own = data.get("robot")
    if robot is not None:
        data["robot"] = str(find_robot_folder(robot).resolve())
    try:
        job = check_job(data, path)
    except InputError as error:
        if any(re.match(rf"{re.escape(key)}(?![\w])", str(error.where or "")) for key in changed):
            raise InputError(error.message, where=f"--set {error.where}") from None
        raise
    return job.with_context(own_robot=own) if robot is not None and isinstance(own, str) else job


def _change_key(data: dict[str, Any], change: str) -> str:
    """Set a key of a job's sections, "plan.tolerance_mm=0.05", and return its name; a bare word is text."""
    key, sign, text = (part.strip() for part in change.partition("="))
    *tables, last = key.split(".")
    if not sign or not all((*tables, last)):
        raise InputError(f"--set is {change!r}, expected KEY=VALUE such as plan.tolerance_mm=0.05")
    try:
        (value,) = tomllib.loads(f"value = {text}").values()
    except ValueError:
        if not BARE_WORD.fullmatch(text):
            raise InputError(f"is {text!r}, expected a TOML value", where=f"--set {key}") from None
        value = text
    table = data
    for name in tables:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"{name!r} is not a section of the job", where=f"--set {key}")
    table[last] = value
    note_input(Path(f"--set {change}"), change.encode())
    return key


def write_schema() -> str:
    """Return the JSON schema of a job file as text."""
    schema = Job.model_json_schema(by_alias=True)
    tables = schema["$defs"]
    models: Any = Annotated[Union[tuple(model.table for model in FORCE_MODELS.values())], Field(discriminator="model")]  # noqa: UP007
    union, process = TypeAdapter(models).json_schema(by_alias=True), schema["properties"]["process"]
    schema["$defs"] = tables = {**tables, **union.pop("$defs")}
    schema["properties"]["process"] = {"default": process["default"], **union, "title": "Process"}
    del tables["ForceTable"]
    wanted = tables["PlanTable"]["properties"]["configuration"]
    tables["PlanTable"]["properties"]["configuration"] = {
        "anyOf": [{"const": "auto"}, {"$ref": wanted["$ref"]}], "default": "auto"
    }  # fmt: skip
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "compplan job"}
    return json.dumps(head, indent=2)
