"""`compplan map`: deflection, stiffness and dexterity over a horizontal and a vertical plane."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from compplan.cli.options import Answer, complete_robots, make_command, out_folder
from compplan.cli.terminal import show_progress
from compplan.effects import robot_effects
from compplan.errors import InputError
from compplan.reporting.map import write_map
from compplan.reporting.maps.reach import POSTURES
from compplan.reporting.maps.survey import MapSettings, map_robot
from compplan.robot import load_robot

#: Greatest load [N, Nm] and height [mm] that are taken for true.
MOST_LOAD, FARTHEST_MM = 1e5, 1e5


@make_command(
    click.argument("robot", shell_complete=complete_robots), out_folder,
    click.option("--posture", type=click.Choice(POSTURES), default="down", show_default=True,
                 help="How the tool points; straight: wrist joints at zero."),
    click.option("--force", nargs=3, type=float, default=(0.0, 0.0, 1000.0), show_default=True,
                 help="Force on the tool, base axes. [N]"),
    click.option("--moment", nargs=3, type=float, default=(0.0, 0.0, 0.0), show_default=True,
                 help="Moment on the tool at the TCP, base axes. [Nm]"),
    click.option("--height-mm", type=float, default=500.0, show_default=True, help="Height of the horizontal plane."),
    click.option("--azimuth-deg", type=float, default=0.0, show_default=True, help="Direction of the vertical plane."),
    click.option("--points", type=click.IntRange(5, 1000), default=100, show_default=True,
                 help="Points along each side."),
    click.option("--reduced", help="Robot folder of a reduced model to compare with; by default it is fitted."),
)  # fmt: skip
def command(
    robot: str, folder: Path, posture: str, force: tuple[float, ...], moment: tuple[float, ...], height_mm: float,
    azimuth_deg: float, points: int, reduced: str | None,
) -> Answer:  # fmt: skip
    """Draw how far ROBOT yields: under the worst unit force and under a given wrench, over two planes.

    Example: compplan map kuka_kr270 --force 0 0 -800 --out out
    """
    wrench = np.array([*force, *moment])
    if not np.isfinite([*wrench, height_mm, azimuth_deg]).all():
        raise InputError("force, moment, height and azimuth are finite numbers")
    if max(map(abs, wrench)) > MOST_LOAD or abs(height_mm) > FARTHEST_MM or abs(azimuth_deg) > 360.0:
        raise InputError(
            f"--force and --moment are at most {MOST_LOAD:g} N or Nm, --height-mm {FARTHEST_MM:g}, --azimuth-deg 360"
        )
    settings = MapSettings(posture, wrench, height_mm * 1e-3, float(np.radians(azimuth_deg)), points)
    loaded = load_robot(robot)
    robot_effects(loaded)  # they move no map, but a wrong file is told here too
    with show_progress() as progress:
        progress("maps of two planes")
        result = map_robot(loaded, settings, None if reduced is None else load_robot(reduced))
        progress("pictures and report")
        write_map(result, folder)
    wrote = f"wrote {folder / 'map.json'}, {folder / 'report.html'}"
    return Answer(result.summary(), [*result.lines(), wrote])
