"""JSON schema of a job for editors, plug-ins included."""

from __future__ import annotations

import json
from typing import Any

from compplan.job.job import Job

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def describe_schema() -> dict[str, Any]:
    """Return the JSON schema of a job file."""
    schema = Job.model_json_schema(by_alias=True)
    tables = schema["$defs"]
    wanted = tables["PlanTable"]["properties"]["configuration"]
    tables["PlanTable"]["properties"]["configuration"] = {
        "anyOf": [{"const": "auto"}, {"$ref": wanted["$ref"]}], "default": "auto"
    }  # fmt: skip
    return {"$schema": DIALECT, **schema, "title": "compplan job"}


def write_schema() -> str:
    """Return the schema as text."""
    return json.dumps(describe_schema(), indent=2)
