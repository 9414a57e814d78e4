"""Custom post-processor: one Jinja template that writes the complete program, moves included; no Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_table, quaternions, rotation_vectors
from compplan.controllers.writers.post import render_post
from compplan.controllers.writers.program import Program, head_lines, joint_percent
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import OTHER, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text
from compplan.toolpath.events import find_halts

name = "own"
LONGEST_NAME = 60


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write a file NAME with the file extension that the template's name has before .jinja."""
    template = program.post.template
    if template is None:
        raise InputError("programs 'own' need a template: output.templates own; compplan init template own writes one")
    fitted = program if program.form == "joint" else fit_moves(program).program
    name = legal_name(program.post.main or program.name, LONGEST_NAME)
    words = {
        "name": name, "comments": head_lines(program), "cell": program.post.words,
        "robot": program.robot, "controller": program.controller, "joint_names": list(program.joint_names),
        "tool": _tabulate_poses(program.tool[None])[0], "base": _tabulate_poses(program.base_frame[None])[0],
        "mass_kg": program.mass, "centre_mm": (program.centre * 1e3).tolist(), "moves": _list_moves(fitted),
        "before": [vars(event) for event in program.events if event.place < 0],
    }  # fmt: skip
    file = folder / f"{words['name']}{Path(template.name.removesuffix('.jinja')).suffix or '.txt'}"
    write_text(file, render_post(program, "own", words))
    return [file]


def _list_moves(program: Program) -> list[dict[str, Any]]:
    """Return the data of each move for a template: kind, end, feed, whether it stops, and the events after it."""
    linear = program.form != "joint"
    alone, stops, arcs = program.alone(linear=linear), program.stops(linear=linear), program.arcs
    places = _tabulate_poses(program.positions) if linear else [None] * len(program)
    middles = dict(zip(np.flatnonzero(arcs).tolist(), _tabulate_poses(program.via_positions[arcs]), strict=True))
    zones = 1e3 * find_zones(program, OTHER)[0] if linear else np.zeros(len(program))
    percent, halts = joint_percent(program), set(find_halts(program.events))
    moves = []
    for row in range(len(program)):
        kind = "rapid" if program.rapid[row] else "joint" if alone[row] or not linear else "line"
        moves.append({
            "kind": "arc" if kind == "line" and arcs[row] else kind, "row": row, "end": places[row],
            "via": middles.get(row), "joints": program.joints[row].tolist(), "feed_mm_s": float(program.feed[row]),
            "percent": float(percent[row]), "stop": bool(stops[row]), "halts": row in halts,
            "zone_mm": float(zones[row]),
            "line": 0 if program.line_of is None else int(program.line_of[row]),
            "events": [vars(event) for event in program.events if event.place == row],
        })  # fmt: skip
    return moves


def _tabulate_poses(poses: Array) -> list[dict[str, Any]]:
    """Return poses as positions and as orientations in the notation of every maker."""
    place = (poses[:, :3, 3] * 1e3 + 0.0).tolist()
    turns = {key: place_table(poses, order)[:, 3:].tolist() for key, order in
             (("abc_deg", "ZYX"), ("wpr_deg", "xyz"), ("val3_deg", "XYZ"), ("zyz_deg", "ZYZ"))}  # fmt: skip
    turns |= {"quaternion": quaternions(poses).tolist(), "rotation_rad": rotation_vectors(poses).tolist()}
    turns |= {"axis": (-poses[:, :3, 2] + 0.0).tolist()}
    return [
        {"x": at[0], "y": at[1], "z": at[2], **{key: values[row] for key, values in turns.items()}}
        for row, at in enumerate(place)
    ]
