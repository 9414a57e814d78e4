"""Configuration words of postures, read a second time: controller.toml says what they are, the URDF where links are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import read_text
from compplan.io.tomlfile import read_toml
from compplan.io.xmlfile import parse_xml
from compplan.robot import Array

#: Words this near to their threshold may be told either way. [deg or mm]
DOUBTFUL = 1e-2


@dataclass(frozen=True)
class PostureWord:
    """One word of the configuration at every row.

    Attributes:
        above: Whether the row has the value that stands above the threshold. Shape (n,).
        sure: Whether it lies clear of the threshold. Shape (n,).
        names: Its two values, that above and that below.
        status: What each adds to S of a KRL position, empty where not said.
        native: The controller's own word for each, empty where not said.

    """

    above: NDArray[np.bool_]
    sure: NDArray[np.bool_]
    names: tuple[str, str]
    status: Mapping[str, int] = field(default_factory=dict)
    native: Mapping[str, str] = field(default_factory=dict)

    @property
    def values(self) -> list[str]:
        """The value at every row."""
        return [self.names[0] if above else self.names[1] for above in self.above.tolist()]


def read_words(folder: Path, names: tuple[str, ...], q: Array) -> dict[str, PostureWord]:
    """Return the configuration words that controller.toml of a robot folder states, at postures.

    Args:
        folder: The robot folder.
        names: Commanded joints.
        q: Their positions. Shape (n, nq). [rad or m]

    """
    file, found = folder / "controller.toml", {}
    table = read_toml(file) if file.is_file() else {}
    stated: Mapping[str, Any] = table.get("configuration", {})
    links = {word[key] for word in stated.values() if "joint" not in word for key in ("point", "frame")}
    places = _locate(folder, links, dict(zip(names, q.T, strict=True)), len(q)) if links else {}
    for key, word in stated.items():
        if "joint" in word:
            turned = np.degrees(q[:, names.index(word["joint"])]) - word.get("threshold_deg", 0.0)
            number = np.degrees(np.arctan2(np.sin(np.radians(turned)), np.cos(np.radians(turned))))
            clear = np.minimum(np.abs(number), 180.0 - np.abs(number))
        else:
            seen = np.linalg.inv(places[word["frame"]]) @ places[word["point"]]
            number = 1e3 * seen[:, "xyz".index(word.get("axis", "x")), 3] - word.get("threshold_mm", 0.0)
            clear = np.abs(number)
        names_of = str(word["above"]), str(word["below"])
        found[key] = PostureWord(
            number >= 0.0, clear > DOUBTFUL, names_of, word.get("status", {}), word.get("native", {})
        )
    return found


def _locate(folder: Path, links: set[str], moved: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Return the poses of links, base frame; the controller's own geometry where the folder has it. (n, 4, 4) [m]."""
    believed = folder / "controller.urdf"
    file = believed if believed.is_file() else folder / "robot.urdf"
    root = parse_xml(read_text(file), file)
    above = {_attribute(joint, "child", "link"): joint for joint in root.findall("joint")}
    found = {}
    for link in links:
        pose, at = np.tile(np.eye(4), (count, 1, 1)), link
        while at in above:
            joint = above[at]
            pose = _frame(joint) @ _turned(joint, moved, count) @ pose
            at = _attribute(joint, "parent", "link")
        found[link] = pose
    return found


def _attribute(element: ElementTree.Element, tag: str, key: str, default: str = "") -> str:
    found = element.find(tag)
    return default if found is None else found.get(key, default)


def _frame(joint: ElementTree.Element) -> Array:
    """Return where a joint stands on its parent: fixed angles roll, pitch, yaw about x, y, z. Shape (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = [float(text) for text in _attribute(joint, "origin", "xyz", "0 0 0").split()]
    for k, text in enumerate(_attribute(joint, "origin", "rpy", "0 0 0").split()):
        pose[:3, :3] = _rodrigues(np.eye(3)[k], np.array([float(text)]))[0] @ pose[:3, :3]
    return pose


def _turned(joint: ElementTree.Element, moved: Mapping[str, Array], count: int) -> Array:
    """Return how far a joint has moved. Shape (n, 4, 4)."""
    pose, mimic = np.tile(np.eye(4), (count, 1, 1)), joint.find("mimic")
    name, factor, shift = joint.get("name", ""), 1.0, 0.0
    if mimic is not None:
        name = mimic.get("joint", "")
        factor, shift = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    if name not in moved or joint.get("type") == "fixed":
        return pose
    value = factor * moved[name] + shift
    axis = np.array([float(text) for text in _attribute(joint, "axis", "xyz", "1 0 0").split()])
    axis /= np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        pose[:, :3, 3] = value[:, None] * axis
    else:
        pose[:, :3, :3] = _rodrigues(axis, value)
    return pose


def _rodrigues(axis: Array, angle: Array) -> Array:
    """Return rotations about an axis. Shape (n, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * cross + (1.0 - c) * cross @ cross)
