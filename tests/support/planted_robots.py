"""Robot folders whose collision shapes are planted wrongly, drawn from a seed: shipped arms as shops copy them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import trimesh

from compplan.robot import find_robot_folder, robot_folders

#: What is planted; "capsule" and "sound" are read, all others hide a part of the arm.
PLANTS = ("missing", "capsule", "none", "package", "scale", "mm")
#: Factors of a wrong scale: mm for m either way, inches, and metres that an exporter scaled twice.
FACTORS = (1e-3, 25.4e-3, 1.0 / 39.37, 25.4, 39.37, 1e3, 1e-6)


class Planted(NamedTuple):
    """A planted folder: where it is, what is planted, and the links that it concerns."""

    folder: Path
    plant: str
    links: tuple[str, ...]


def plant_robot(folder: Path, seed: int, plant: str | None = None, name: str | None = None) -> Planted:
    """Write a shipped arm (drawn if None) with one of `PLANTS` (in turn if None), in all links or in one."""
    rng = np.random.default_rng(seed)
    plant = PLANTS[seed % len(PLANTS)] if plant is None else plant
    arms = sorted(robot_folders())
    shutil.copytree(find_robot_folder(arms[int(rng.integers(len(arms)))] if name is None else name), folder)
    root = ElementTree.parse(folder / "robot.urdf").getroot()
    moving = {str(j.find("child").get("link")) for j in root.findall("joint") if j.get("type") != "fixed"}  # type: ignore[union-attr]
    shown = [link for link in root.findall("link") if link.find("collision") is not None]
    one = [link for link in shown if link.get("name") in moving]
    # a scale that is off by inches shows in long links alone: it is planted in all
    chosen = [one[int(rng.integers(len(one)))]] if rng.random() < 0.5 and plant != "scale" else shown
    factor = float(rng.choice(FACTORS))
    for link in chosen:
        for number, collision in enumerate(link.findall("collision")):
            if plant == "none":
                link.remove(collision)
            else:
                _plant_shape(folder, collision, f"{link.get('name')}_{number}.stl", plant, factor)
    (folder / "robot.urdf").write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    return Planted(folder, plant, tuple(str(link.get("name")) for link in chosen if link.get("name") in moving))


def _plant_shape(folder: Path, collision: ElementTree.Element, file: str, plant: str, factor: float) -> None:
    """Put a mesh or a capsule where a box, cylinder or sphere was."""
    geometry = collision.find("geometry")
    assert geometry is not None
    old = geometry[0]
    if plant == "capsule":
        if old.tag == "cylinder":
            old.tag = "capsule"
        return
    mesh = make_mesh(old)
    geometry.remove(old)
    (folder / "meshes").mkdir(exist_ok=True)
    if plant not in ("missing", "package"):
        mesh.apply_scale({"scale": 1.0, "mm": 1e3}.get(plant, 1.0)).export(folder / "meshes" / file)
    address = {"package": f"package://arm_support/meshes/collision/{file}"}.get(plant, f"meshes/{file}")
    ElementTree.SubElement(geometry, "mesh", filename=address)
    if plant == "scale":
        geometry[0].set("scale", f"{factor} {factor} {factor}")


def make_mesh(shape: ElementTree.Element) -> trimesh.Trimesh:
    """Return a primitive of a URDF as a mesh."""
    if shape.tag == "box":
        return trimesh.creation.box([float(word) for word in shape.get("size", "").split()])
    radius = float(shape.get("radius", "0"))
    if shape.tag == "sphere":
        return trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return trimesh.creation.cylinder(radius, float(shape.get("length", "0")))
