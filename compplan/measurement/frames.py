"""How the frames of a log move, and what that does to its measured poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.measurement.observations import Observations
from compplan.measurement.registration import CONTACTS, Registration
from compplan.robot import Array

#: Along and about which axes a frame moves.
TURNS: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")


def frame_columns(
    frames: Registration, position: Array, tcp_rotation: Array, target: NDArray[np.int_], turned: bool,
    sights: Observations | None = None,
) -> list[Array]:  # fmt: skip
    """Differentiate measured poses by the fitted frames, in the order of `move_frames`. Shapes (n, 6, 3 or 6).

    Args:
        frames: The frames.
        position: Measured points as predicted, measuring frame. Shape (n, 3). [m]
        tcp_rotation: Orientation of the TCP, base axes. Shape (n, 3, 3).
        target: Index of the measured point. Shape (n,).
        turned: Whether orientation is measured; without it a tool is a point.
        sights: What other instruments saw: places of contacts move it, the base of a tracker does not.
    """
    n, parts = len(position), []
    if "base" in frames.parts:
        base = np.zeros((n, 6, 6))
        base[:] = np.eye(6)
        lever = position - frames.base[:3, 3]
        for axis, unit in enumerate(np.eye(3)):
            base[:, :3, 3 + axis] = np.cross(unit, lever)
        if sights is not None:
            base[sights.seen] = 0.0
        parts.append(base)
    if "tool" in frames.parts:
        size = 6 if turned else 3
        axes = frames.base[:3, :3] @ tcp_rotation
        for number in range(len(frames.tool)):
            tool = np.zeros((n, 6, size))
            own = np.flatnonzero(target == number)
            tool[own, :3, :3] = axes[own]
            if size == 6:
                tool[own, 3:, 3:] = axes[own]
            parts.append(tool)
    if CONTACTS in frames.parts and sights is not None:
        slopes = -np.einsum("ij,njlk->nilk", frames.base[:3, :3], sights.place_slopes()).reshape(n, 3, -1)
        parts.append(np.concatenate([slopes, np.zeros_like(slopes)], axis=1))
    return parts


def name_frames(frames: Registration, turned: bool) -> list[tuple[str, str, tuple[str, ...]]]:
    """Name the fitted frames in the order of `move_frames`: label, part, and along or about which axes each moves."""
    many = len(frames.tool) > 1
    found = [("base", "base", TURNS)] if "base" in frames.parts else []
    if "tool" in frames.parts:
        labels = [f"tool({label or k})" if many else "tool" for k, label in enumerate(frames.targets, 1)]
        found += [(label, "tool", TURNS if turned else TURNS[:3]) for label in labels]
    if CONTACTS in frames.parts:
        found += [(f"contact({label})", CONTACTS, TURNS[:3]) for label in frames.contacts]
    return found


def move_frames(frames: Registration, change: Array, turned: bool) -> Registration:
    """Move the fitted frames by a step: each turns about its own origin, in measuring axes and in TCP axes."""
    base, tools, used = frames.base.copy(), frames.tool.copy(), 0
    moved = [(base, 6)] if "base" in frames.parts else []
    if "tool" in frames.parts:
        moved += [(tool, 6 if turned else 3) for tool in tools]
    for pose, size in moved:
        step = np.zeros(6)
        step[:size] = change[used : used + size]
        pose[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += step[:3]
        used += size
    places = frames.places + change[used:].reshape(-1, 3) if CONTACTS in frames.parts else frames.places
    return replace(frames, base=base, tool=tools, places=places)
