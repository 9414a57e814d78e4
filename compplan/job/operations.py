"""Jobs with several tools: one job for each operation."""

from __future__ import annotations

from typing import Any

from compplan.errors import InputError
from compplan.job.job import Job, check_job
from compplan.job.loading import job_toolpath_file
from compplan.job.tool_tables import read_tool_library
from compplan.job.tools import Described, called_speed, fill_process, find_listed, find_numbered
from compplan.toolpath.operations import Operation, split_operations
from compplan.toolpath.reading import read_toolpath


def split_job(job: Job) -> tuple[Job, ...]:
    """Split a job at the tool changes of its CAM file; each part has tool, tool mass and force law of its T number.

    A job with neither [[tool]] nor [tools] is returned unchanged, as the only item.

    Raises:
        InputError: If there is no CAM file, or it cuts with a tool that the job does not describe.
    """
    if not job.context.tools and job.tool_table is None:
        return (job,)
    operations = _read_operations(job)
    wanted = range(1, len(operations) + 1) if job.cam.operation is None else (job.cam.operation,)
    if wanted[-1] > len(operations):
        tools = ", ".join(operation.tool for operation in operations)
        message = f"is {wanted[-1]}, the CAM file has {len(operations)} (tools {tools})"
        raise InputError(message, file=job.file, where="cam.operation")
    labels = label_operations(operations)
    made: list[Job] = []
    for number in range(1, wanted[-1] + 1):
        operation = operations[number - 1]
        try:
            tool = _describe(job, operation)
            one = _make_job(job, number if len(operations) > 1 else None, operation, tool, labels[number - 1])
        except InputError:
            if number in wanted:
                raise
            continue  # its earlier cuts are unknown
        made.append(one.with_context(before=tuple(made)))
    return tuple(made) if job.cam.operation is None else (made[-1],)


def _read_operations(job: Job) -> tuple[Operation, ...]:
    """Return the operations of the job's CAM file, or of the toolpath in memory."""
    if job.context.given is not None:
        return split_operations(job.context.given)
    file = job_toolpath_file(job) if isinstance(job.toolpath, str) else None
    if file is None or file.suffix.lower() == ".csv":
        message = "describes tools by number, and the toolpath is no CAM file that calls any: write [tool]"
        raise InputError(message, file=job.file, where="tool" if job.context.tools else "tools")
    cam = job.cam.model_copy(update={"operation": None})
    feed = None if job.feed.constant_mm_s is None else job.feed.constant_mm_s * 1e-3
    return split_operations(read_toolpath(file, cam=cam, feed=feed))


def label_operations(operations: tuple[Operation, ...]) -> list[str]:
    """Return short names of operations: T1, T2; T1_run2 where T1 cuts again; op3 where a tool is called by name."""
    labels: list[str] = []
    for count, operation in enumerate(operations, 1):
        label = f"op{count}" if operation.name else f"T{operation.number}"
        times = sum(other == label or other.startswith(f"{label}_run") for other in labels)
        labels.append(f"{label}_run{times + 1}" if times else label)
    return labels


def require_single_operation(job: Job) -> Job:
    """Return the job of the only operation, or of [cam] operation.

    Raises:
        InputError: If none of several is selected, or the tool is not described.
    """
    jobs = split_job(job)
    if len(jobs) > 1:
        tools = ", ".join(f"{k} {one.label}" for k, one in enumerate(jobs, 1))
        message = f"the CAM file has {len(jobs)} operations ({tools}) and this takes one"
        raise InputError(f"{message}; write [cam] operation = 1", file=job.file, where="cam.operation")
    return jobs[0]


def _describe(job: Job, operation: Operation) -> Described:
    """Return the description of the tool of an operation.

    Raises:
        InputError: If there is none.
    """
    if job.tool_table is not None:
        file = job.folder / job.tool_table.file
        found = find_listed(read_tool_library(file), operation, job.tool, file)
        if found is None:
            message = f"the CAM file cuts with {operation.tool}, and {job.tool_table.file} has no such tool"
            raise InputError(f"{message}; add it there", file=job.file, where="tools.file")
        return found
    found = find_numbered(job.context.tools, operation)
    if found is None:
        key = f'name = "{operation.name}"' if operation.name else f"number = {operation.number}"
        start = "" if operation.name or operation.number else " before it calls any tool (T0)"
        message = f"the CAM file cuts with {operation.tool}{start}, and no [[tool]] describes it"
        raise InputError(f"{message}; write [[tool]] with {key}", file=job.file, where="tool")
    return found


def _make_job(job: Job, number: int | None, operation: Operation, described: Described, label: str) -> Job:
    """Return the job of one operation."""
    data: dict[str, Any] = {key: value for key, value in job.context.data.items() if key != "tools"}
    data["tool"] = described.tool
    if number is not None:
        data["cam"] = {**data.get("cam", {}), "operation": number}
        data["name"] = f"{job.name or job.file.stem}, {label}"
    given = None if job.context.given is None else operation.toolpath
    try:
        process = fill_process(job.context.data.get("process", {}), described, called_speed(operation))
        if process is not None:
            data["process"] = process
        made = check_job(data, job.file, toolpath=given, robot=job.context.mounted)
    except InputError as error:
        where = str(error.where or "")
        if where.startswith(("process", "tool")):
            message = f"{error.message} ({operation.tool}: {described.where})"
            raise InputError(message, file=error.file or job.file, where=where) from None
        raise
    return made.with_context(label=label if number is not None else "", own_robot=job.context.own_robot)
