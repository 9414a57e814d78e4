"""Write observations as a measurement log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.io.columns import to_unit
from compplan.io.tables import write_table
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot


def write_campaign_log(observations: Campaign, robot: Robot, file: Path, *, decimals: int = 6) -> None:
    """Write observations as a measurement log of settled poses, one run."""
    n = len(observations)
    columns: dict[str, object] = {"run": np.array(["static_1"] * n)}
    if observations.link_controlled.any():
        loaded = np.abs(observations.wrench).max(axis=1) > 0
        columns["mode"] = np.where(loaded, "L", "U").astype(object) + np.where(observations.link_controlled, "2", "1")
    columns |= robot.joint_columns(observations.q)
    for k, header in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        columns[header] = observations.wrench[:, k]
    for k, header in enumerate(("x_mm", "y_mm", "z_mm")):
        columns[header] = to_unit(observations.position[:, k], header)
    if observations.rotation is not None:
        vectors = Rotation.from_matrix(observations.rotation).as_rotvec()
        for k, header in enumerate(("rx_deg", "ry_deg", "rz_deg")):
            columns[header] = to_unit(vectors[:, k], header)
        columns["sigma_deg"] = to_unit(observations.sigma_rotation, "sigma_deg")
    columns["sigma_mm"] = to_unit(observations.sigma, "sigma_mm")
    write_table(file, columns, decimals=decimals)
