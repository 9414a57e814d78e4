"""Incremental sheet forming: the regression of Aerens and others (2010) for the steady axial force.

    F_z = 0.0716 R_m t^1.57 d^0.41 h^0.09 a cos(a)

R_m tensile strength [N/mm^2], t thickness, d tool diameter, h scallop height [mm], a wall angle [deg]; F_z in N.
Source: Aerens, Eyckens, Van Bael, Duflou, Int. J. Adv. Manuf. Technol. 46 (2010) 969, the form for materials that they
did not test, as commonly quoted; not checked against the print. The separate forms of their five materials could not be
sourced. Quotes leave open whether h is the scallop height or the step-down. Here h is the scallop height. The grooves
of a ball of diameter d are step-down / sin(a) apart along the wall, with crests h above their bottom; the radial part
below uses the same groove. With the step-down as h, the force is larger; the note states both, and the uncertainty of
the level covers both. The note also states the ratio of radial to axial force from the equilibrium of a strip of sheet
under uniform tension T, bent over the ball from the flat into the wall: it pushes with T sin(a) along the axis and
T (1 - cos(a)) to the side, a ratio of tan(a / 2). Valid, as far as known, for t 0.8 to 2 mm, d 10 to 25 mm, step-down
0.25 to 2 mm, a 20 to 65 deg, steel and aluminium sheet. Radial and tangential parts are assumed: the mean normal of the
contact is halfway between wall and scallop, tan((a + b) / 2) with cos(b) = 1 - 2 h / d, and friction acts against the
travel. The force builds up over the first contours, linearly over a depth of the tool's radius (assumed).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.contact import PathForceTable, find_retracts, last_set, path_axes
from compplan.toolpath.toolpath import Toolpath

words = "incremental sheet forming from sheet, tool and path"
#: Friction coefficient of the tool on the sheet (assumed).
FRICTION = 0.1
#: Assumed range of validity of the regression. [mm], [deg]
VALID = {
    "thickness": (0.8, 2.0), "tool_diameter": (10.0, 25.0), "step_down": (0.25, 2.0), "wall_angle": (20.0, 65.0)
}  # fmt: skip
#: Least angle of a wall. [rad]
FLATTEST = float(np.radians(8.0))
#: Range of depth in which the next contour is expected, in step-downs.
NEXT_CONTOUR = (0.6, 1.4)


class IsfRegressionProcess(PathForceTable):
    """Force of incremental sheet forming, from sheet, tool and path."""

    #: Relative standard deviation of the level (assumed): .15 for the regression, .2 for the interpretation of h. Twice
    #: this value covers a step-down of up to 80 scallop heights, 80^0.09 = 1.48.
    uncertainty: ClassVar[float] = 0.25
    model: Literal["isf_regression"]
    thickness_mm: float = Field(gt=0.0, le=10.0)
    tool_diameter_mm: float = Field(gt=0.0, le=100.0)
    tensile_N_mm2: float = Field(ge=20.0, le=3000.0)
    wall_side: Literal["left", "right"] = "right"

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench on the forming tool at every waypoint, path axes; zero while it is lifted off. (n, 6)

        Raises:
            InputError: If step-down or wall angle cannot be determined from the path.
        """
        depth = _sink(nominal)
        step, angle = find_contours(nominal)
        height = scallop_height(step, self.tool_diameter_mm, angle)
        axial = steady_axial_force(self.tensile_N_mm2, self.thickness_mm, self.tool_diameter_mm, height, angle)
        radial = axial * radial_ratio(height, self.tool_diameter_mm, angle)
        share = np.clip((depth * 1e3 + step) / (0.5 * self.tool_diameter_mm), 0.0, 1.0)
        side = 1.0 if self.wall_side == "right" else -1.0
        wrench = np.zeros((len(nominal), 6))
        wrench[:, 0] = -FRICTION * np.hypot(axial, radial)
        wrench[:, 1], wrench[:, 2] = side * radial, axial
        return wrench * share[:, None] * ~find_retracts(nominal)[:, None]

    def describe(self, nominal: Toolpath) -> list[str]:
        """Return notes on assumptions, and on values outside the range of the regression."""
        step, angle = find_contours(nominal)
        typical = float(np.degrees(np.median(angle)))
        found = {"thickness": self.thickness_mm, "tool_diameter": self.tool_diameter_mm, "step_down": step,
                 "wall_angle": typical}  # fmt: skip
        outside = [
            f"{name} {found[name]:.3g} (valid {low:g} to {high:g})"
            for name, (low, high) in VALID.items() if not low <= found[name] <= high
        ]  # fmt: skip
        wall = np.radians(typical)
        height = float(scallop_height(step, self.tool_diameter_mm, np.array(wall)))
        sheet = (self.tensile_N_mm2, self.thickness_mm, self.tool_diameter_mm)
        read, other = (float(steady_axial_force(*sheet, np.array(size), np.array(wall))) for size in (height, step))
        aside, strip = read * radial_ratio(height, self.tool_diameter_mm, wall), read * np.tan(0.5 * wall)
        notes = [
            f"Forming force by the regression of Aerens and others (2010): {read:.0f} N along the tool for scallops of "
            f"{height:.2g} mm (step-down {step:.3g} mm) and a wall of {typical:.3g} deg; {other:.0f} N if its scallop "
            f"height means the step-down. Assumed: +- {100 * self.uncertainty:g} %, a radial part of {aside:.0f} N "
            f"({strip:.0f} N for even tension), friction {FRICTION:g}, build-up over the first contours."
        ]
        if outside:
            notes.append(f"Outside the range of the regression: {', '.join(outside)}.")
        return notes


def scallop_height(step_down: float, diameter: float, angle: Array) -> Array:
    """Return the height of the crest between two contours above the grooves of a ball end. [mm]

    `step_down` is the depth from contour to contour [mm], `angle` that of the wall against the sheet. [rad]
    """
    radius = 0.5 * diameter
    half = np.minimum(0.5 * step_down / np.maximum(np.sin(angle), 1e-9), radius)
    return np.asarray(half**2 / (radius + np.sqrt(radius**2 - half**2)))


def steady_axial_force(strength: float, thickness: float, diameter: float, height: Array, angle: Array) -> Array:
    """Return the steady axial force [N] of the regression.

    Strength is in N/mm^2, thickness, diameter of the tool and height of the scallop in mm, the wall's angle in rad.
    """
    size = 0.0716 * strength * thickness**1.57 * diameter**0.41 * np.asarray(height) ** 0.09
    return np.asarray(size * np.degrees(angle) * np.cos(angle))


def radial_ratio(height: Array | float, diameter: float, angle: Array | float) -> Array:
    """Return radial over axial force for a mean contact normal halfway between wall and scallop."""
    groove = np.arccos(np.clip(1.0 - 2.0 * np.asarray(height) / diameter, -1.0, 1.0))
    return np.asarray(np.tan(0.5 * (np.asarray(angle) + groove)))


def find_contours(nominal: Toolpath) -> tuple[float, Array]:
    """Return step-down [mm] and wall angle [rad], shape (n,), of a path."""
    step = find_step_down(nominal)
    return 1e3 * step, find_wall_angle(nominal, step)


def find_step_down(nominal: Toolpath) -> float:
    """Return the step-down between contours: of levels, or of the turns of a helix. [m]

    Raises:
        InputError: If the path does not go round and down.
    """
    rows = np.flatnonzero(~nominal.rapid)
    place, depth = nominal.position[rows], _sink(nominal)[rows]
    level = np.abs(np.diff(depth)) < 1e-9
    if level.mean() > 0.5:
        levels = np.unique(np.round(depth[1:][level], 7))
        if len(levels) > 1:
            return float(np.median(np.diff(levels)))
    step = np.diff(place, axis=0)
    step -= np.einsum("ni,ni->n", step, nominal.axis[rows[1:]])[:, None] * nominal.axis[rows[1:]]
    step = step[np.linalg.norm(step, axis=1) > 1e-9]
    axis = nominal.axis[rows[0]]
    cross = np.cross(step[:-1], step[1:]) @ axis
    turns = abs(float(np.arctan2(cross, np.einsum("ni,ni->n", step[:-1], step[1:])).sum())) / (2.0 * np.pi)
    if turns < 1.0 or depth.max(initial=0.0) <= 0.0:
        message = 'needs a path that circles and descends; for others state the forces: model = "isf"'
        raise InputError(message, where="process.model")
    return float(depth.max() / turns)


def find_wall_angle(nominal: Toolpath, step_down: float) -> Array:
    """Return the angle of the wall against the sheet: from each waypoint to the nearest one of the next lower contour.

    The last contour keeps the angle of the one above. Shape (n,). [rad]

    Raises:
        InputError: If no contour has a next one.
    """
    depth, axis = _sink(nominal), nominal.axis[0]
    flat = nominal.position - (nominal.position @ axis)[:, None] * axis
    cutting = np.flatnonzero(~nominal.rapid)
    angle = np.full(len(nominal), np.nan)
    travel = path_axes(nominal)[:, :, 0]
    for low in np.arange(0.0, depth[cutting].max(initial=0.0) + 1e-12, 0.5 * step_down):
        here = cutting[(depth[cutting] >= low - 1e-9) & (depth[cutting] < low + 0.5 * step_down - 1e-9)]
        near, far = low + NEXT_CONTOUR[0] * step_down, low + (NEXT_CONTOUR[1] + 0.5) * step_down
        below = cutting[(depth[cutting] >= near) & (depth[cutting] <= far)]
        if not len(here) or not len(below):
            continue
        other = below[cKDTree(flat[below]).query(flat[here])[1]]
        aside = flat[other] - flat[here]
        along = np.einsum("ni,ni->n", aside, travel[here])
        distance = np.linalg.norm(aside - along[:, None] * travel[here], axis=1)
        # the last contour has none below it; a match is then ahead, or across the part
        beside = (np.abs(along) <= np.maximum(distance, step_down)) & (distance <= step_down / np.tan(FLATTEST))
        found = np.arctan2(depth[other] - depth[here], np.maximum(distance, 1e-9))
        angle[here[beside]] = found[beside]
    known = np.isfinite(angle)
    if not known.any():
        message = 'needs a path with a contour above another; give the forces, model = "isf"'
        raise InputError(message, where="process.model")
    return np.asarray(angle[last_set(known)])


def _sink(nominal: Toolpath) -> Array:
    """Return the depth of the tip below the highest waypoint of the cut, along its axis. Shape (n,). [m]"""
    cutting = np.flatnonzero(~nominal.rapid)
    height = nominal.position @ nominal.axis[0]
    top = height[cutting].max() if len(cutting) else height.max()
    return np.asarray(np.maximum(top - height, 0.0))


table = IsfRegressionProcess
