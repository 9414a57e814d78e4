"""Crashes and gouges planted in the shipped jobs of cutters: `python -m benchmarks.crashes`.

Each case changes what goes wrong in a shop: a rapid move in place of a cut, a retract left out, a wrong zero, tool
length, radius, flute or holder, a plunge beside the part. What is asked: does the plan's path name it, by its kind, and
do the jobs as shipped, beside exact meshes of their parts, stay without a word.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from compplan.io.notes import Crash
from compplan.job.job import Job, check_job, load_job
from compplan.job.loading import load_path, load_toolpath
from compplan.job.operations import split_job
from compplan.toolpath.toolpath import Toolpath

EXAMPLES = Path(__file__).parent.parent / "examples"
RAPID, FLUTE, HOLDER, GOUGE = "Rapid moves", "flute", "holder", "gouge"


def draw_pocket(file: Path) -> None:
    """Write the part of the shipped pocket: 60 x 40 x 6 mm in its block, corners left sharp."""
    bounds = [np.array(v, float) for v in ([[-10, -10], [70, 50]], [[0, 0], [60, 40]])]
    outer, inner = (np.array([[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]]) for a, b in bounds)
    rings = [np.column_stack([ring, np.full(4, z)]) for ring, z in
             ((outer, -25.0), (outer, 0.0), (inner, 0.0), (inner, -6.0))]  # fmt: skip
    faces = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for ring in range(3):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    mesh = trimesh.Trimesh(np.vstack(rings), faces, process=False)
    assert mesh.is_watertight and abs(mesh.volume - (80 * 60 * 25 - 60 * 40 * 6)) < 1.0, mesh.volume
    mesh.export(file)


def draw_dome(file: Path) -> None:
    """Write the part of the shipped dome, half a millimetre between its points."""
    x, y = np.meshgrid(np.linspace(0, 80, 161), np.linspace(0, 60, 121), indexing="ij")
    top = 8.0 * np.exp(-(((x - 40.0) / 18.0) ** 2) - ((y - 30.0) / 14.0) ** 2) + 10.0
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    up = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    ahead, count = np.roll(rim, -1), x.size
    side = np.vstack([np.column_stack([rim, rim + count, ahead]), np.column_stack([ahead, rim + count, ahead + count])])
    points = np.column_stack([np.tile(x.ravel(), 2), np.tile(y.ravel(), 2), np.r_[top.ravel(), np.zeros(count)]])
    trimesh.Trimesh(points, np.vstack([up, up[:, ::-1] + count, side]), process=False).export(file)


def turn_rapid(*rows: int) -> Callable[[Toolpath], Toolpath]:
    def change(path: Toolpath) -> Toolpath:
        rapid, feed = path.rapid.copy(), path.feed.copy()
        rapid[list(rows)], feed[list(rows)] = True, 0.0
        return replace(path, rapid=rapid, feed=feed)

    return change


def move_rows(rows: slice, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Callable[[Toolpath], Toolpath]:
    def change(path: Toolpath) -> Toolpath:
        position = path.position.copy()
        position[rows] += 1e-3 * np.array([x, y, z])
        return replace(path, position=position)

    return change


def lower_rapids(height: float) -> Callable[[Toolpath], Toolpath]:
    """Bring rapid moves down to a height: what was to pass over the stock goes through it."""

    def change(path: Toolpath) -> Toolpath:
        position = path.position.copy()
        position[path.rapid, 2] = np.minimum(position[path.rapid, 2], 1e-3 * height)
        return replace(path, position=position)

    return change


@dataclass(frozen=True)
class Planted:
    """A mistake: what it is, in which job, what has to be said, the change of its path and of its [process]."""

    name: str
    job: str
    kind: str
    path: Callable[[Toolpath], Toolpath] = lambda path: path
    process: dict[str, Any] = field(default_factory=dict)


ALL = slice(None)
PLANTED = (
    Planted("slot driven in rapid", "pocket", RAPID, turn_rapid(4)),
    Planted("ramp driven in rapid", "pocket", RAPID, turn_rapid(2)),
    Planted("zigzag of the second level in rapid", "pocket", RAPID, turn_rapid(30)),
    Planted("way home without a retract", "pocket", RAPID, move_rows(slice(-1, None), x=70, z=-25)),
    Planted("part clamped 10 mm higher", "pocket", RAPID, move_rows(ALL, z=-10)),
    Planted("holes joined below the plate's top", "plate", RAPID, lower_rapids(-2.0)),
    Planted("first hole plunged in rapid", "plate", RAPID, turn_rapid(2)),
    Planted("approach into the dome", "finishing", RAPID, move_rows(slice(1, 2), x=30, y=26)),
    Planted("flute of 2 mm in a level of 3", "pocket", FLUTE, process={"flute_mm": 2.0}),
    Planted("flute of 5 mm, first level left out", "pocket", FLUTE, move_rows(slice(2, 26), z=-3), {"flute_mm": 4.0}),
    Planted("short tool, wide holder", "pocket", HOLDER, process={"holder_mm": [[5.0, 40.0], [60.0, 40.0]]}),
    Planted("holder beside the wall", "pocket", HOLDER, process={"holder_mm": [[4.0, 14.0], [60.0, 50.0]]}),
    Planted("cone of the holder", "pocket", HOLDER, process={"holder_mm": [[3.0, 9.0], [12.0, 60.0], [60.0, 60.0]]}),
    Planted("holder over the dome", "finishing", HOLDER, process={"holder_mm": [[5.0, 50.0], [60.0, 50.0]]}),
    Planted("drill too short for the plate", "plate", HOLDER, process={"holder_mm": [[9.0, 20.0], [60.0, 20.0]]}),
    Planted("zero 0.3 mm too low", "pocket", GOUGE, move_rows(ALL, z=-0.3)),
    Planted("zero 0.3 mm aside", "pocket", GOUGE, move_rows(ALL, x=0.3)),
    Planted("radius compensation of another cutter", "pocket", GOUGE, process={"diameter_mm": 10.5}),
    Planted("one pass 0.25 mm lower", "pocket", GOUGE, move_rows(slice(32, 33), z=-0.25)),
    Planted("tool length 0.2 mm wrong", "finishing", GOUGE, move_rows(ALL, z=-0.2)),
    Planted("flat cutter in place of the ball", "finishing", GOUGE, process={"corner_radius_mm": 0.0}),
    Planted("one row 0.4 mm lower", "finishing", GOUGE, move_rows(slice(960, 961), z=-0.4)),
)  # fmt: skip
#: Process keys that the jobs carry beside what they ship with: parts as they are wanted, tools as they would be held.
MORE: dict[str, dict[str, Any]] = {
    "pocket": {"part": {"mesh": "pocket.stl"}, "holder_mm": [[30.0, 40.0], [80.0, 40.0]]},
    "finishing": {"part": {"mesh": "dome.stl"}, "holder_mm": [[25.0, 30.0], [80.0, 30.0]]},
    "plate": {"holder_mm": [[25.0, 30.0], [80.0, 30.0]]},
}


def change_job(name: str, folder: Path, planted: Planted | None = None) -> Job:
    """Return a shipped job with its part and holder, and with a mistake."""
    job = load_job(EXAMPLES / "forces" / f"{name}.toml")
    path = load_toolpath(job)
    more = dict(MORE[name])
    for key in ("part", "stock"):
        table = {**job.data["process"], **more}.get(key)
        if isinstance(table, dict) and "mesh" in table:
            more[key] = {**table, "mesh": str((folder if key == "part" else job.folder) / table["mesh"])}
    process = {**job.data["process"], **more, **({} if planted is None else planted.process)}
    changed = path if planted is None else planted.path(path)
    return check_job({**job.data, "process": process}, job.file, toolpath=changed)


def list_crashes(job: Job) -> list[str]:
    """Return what the path of a job says of crashes and gouges."""
    return [note for note in load_path(job)[0].notes if isinstance(note, Crash)]


def compare() -> Iterator[tuple[str, str, bool, list[str]]]:
    """Yield the case, the kind that was planted ("" for a job as shipped), whether it was said, and what was said."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draw_pocket(folder / "pocket.stl")
        draw_dome(folder / "dome.stl")
        for planted in PLANTED:
            said = list_crashes(change_job(planted.job, folder, planted))
            yield f"{planted.job}: {planted.name}", planted.kind, any(planted.kind in text for text in said), said
        for shipped in MORE:
            said = list_crashes(change_job(shipped, folder))
            yield f"{shipped}: as shipped", "", bool(said), said
        for file in ("two_tools/bracket.toml", "first_part/part.toml"):
            for job in split_job(load_job(EXAMPLES / file)):
                said = list_crashes(job)
                yield f"{file} {job.label}: as shipped", "", bool(said), said


def main() -> None:
    planted = found = shipped = false = 0
    for name, kind, said, words in compare():
        planted, found = planted + bool(kind), found + (bool(kind) and said)
        shipped, false = shipped + (not kind), false + (not kind and said)
        print(f"{name:55s} {('found' if said else 'NOT FOUND') if kind else ('FALSE' if said else 'silent'):10s} "
              f"{(words or [''])[0][:110]}")  # fmt: skip
    print(f"{found} of {planted} planted crashes and gouges found by their kind; {false} false on {shipped} shipped "
          "jobs")  # fmt: skip


if __name__ == "__main__":
    main()
