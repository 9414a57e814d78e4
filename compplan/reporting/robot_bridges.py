"""Close the gaps between the drawn shapes of an arm: those that serve collision checks stay clear of one another."""

from __future__ import annotations

import itertools

import numpy as np

from compplan.reporting.robot_scene import Shape, locate_links
from compplan.robot import Array, Robot
from compplan.robot.primitives import triangulate_rod

#: Step along the line through the joints, and how far outside a shape still counts as in it. [m]
STEP, TOLERANCE = 0.004, 1e-6
#: Longest gap that is closed, as a share of the length of the stretched links, and width of what closes it.
LONGEST, SLIM = 0.15, 0.7
#: Triangles from which on a shape is a mesh, which need not be convex: such an arm is drawn as it is.
MESH = 400


def bridge_gaps(robot: Robot, q: Array, shapes: list[Shape]) -> list[Shape]:
    """Return rods that close the gaps along the line through the joints' origins, from the base to the flange.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]
        shapes: What is drawn of it at that pose: convex shapes, or nothing is closed.

    """
    if not shapes or any(len(shape.faces) >= MESH for shape in shapes):
        return []
    line = _trace_joints(robot, q)
    within = np.array([_depth(shape, line) > -TOLERANCE for shape in shapes])
    covered = np.asarray(within.any(axis=0))
    bridges: list[Shape] = []
    edges = np.flatnonzero(np.diff(covered.astype(int)))
    for last in edges[covered[edges]]:
        after = edges[edges > last]
        if not len(after):
            break
        first = int(after[0]) + 1
        ends = line[[last, first]]
        if not 0.0 < np.linalg.norm(ends[1] - ends[0]) <= LONGEST * robot.longest_reach:
            continue
        sides = [shapes[int(within[:, row].argmax())] for row in (last, first)]
        radius = SLIM * max(float(_depth(side, side.vertices.mean(axis=0)[None])[0]) for side in sides)
        bridges.append(Shape(sides[0].link, *triangulate_rod(ends[0], ends[1], radius, 20), sides[0].colour))
    return bridges


def _trace_joints(robot: Robot, q: Array) -> Array:
    """Return points along the line through the origins of the links, up to the flange. Shape (k, 3). [m]"""
    poses, names = locate_links(robot, q), [robot.base]
    for joint in robot.joints:
        names.append(joint.child)
        if joint.child == robot.flange:
            break
    corners = np.array([poses[name][:3, 3] for name in names])
    pieces = [corners[:1]]
    for start, end in itertools.pairwise(corners):
        count = int(np.ceil(np.linalg.norm(end - start) / STEP))
        pieces.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.vstack(pieces)


def _depth(shape: Shape, points: Array) -> Array:
    """Return how deep points lie inside a convex shape, negative outside. Shape (k,). [m]"""
    corner = shape.vertices[shape.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return np.asarray(((corner[:, 0] * normal).sum(axis=1)[None] - points @ normal.T).min(axis=1))
