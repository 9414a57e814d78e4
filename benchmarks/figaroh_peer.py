"""FIGAROH's geometric calibration as a contestant; run by `ask_figaroh` under an interpreter that has figaroh.

    python benchmarks/figaroh_peer.py FOLDER TOOL [--register]

FOLDER holds robot.urdf, given.csv and fresh.csv: a column a joint (mimic joints too) and x1, y1, z1 in metres, what the
nominal springs bend under the loads taken off, since FIGAROH takes no loads. All geometric parameters that the campaign
can tell apart, base and target are fitted to positions alone, every row with the same weight, far rows left out.
With --register the later campaign's frame is fitted anew. Writes FOLDER/answer.json.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.calibration.data_loader import load_data
from figaroh.tools.load_robot import load_robot

#: Rows farther off than this after a fit are left out and the fit is repeated (FIGAROH's own default). [m]
OUTLIER, ITERATIONS = 0.05, 3
CONFIG = """
robot: {{name: robot}}
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    kinematics: {{base_frame: universe, tool_frame: {tool}}}
    joints: {{active_joints: [{joints}]}}
    measurements:
      markers: [{{ref_joint: {last}, measurable_dof: [true, true, true, false, false, false]}}]
      poses: {{base_pose: [0, 0, 0, 0, 0, 0], tool_pose: [0, 0, 0, 0, 0, 0]}}
    parameters: {{calibration_level: full_params}}
    data: {{number_of_samples: {rows}, source_file: {data}}}
"""


class Positions(BaseCalibration):  # type: ignore[misc]
    """Calibrate on positions alone."""

    def cost_function(self, var: Any) -> Any:
        """Return measured minus modelled positions. [mm]"""
        model = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return 1e3 * (self.PEE_measured - model)


def calibrate(folder: Path, tool: str) -> Positions:
    """Run FIGAROH on FOLDER/given.csv."""
    lines = (folder / "given.csv").read_text(encoding="utf-8").splitlines()
    joints = lines[0].split(",")[:-3]
    text = CONFIG.format(
        tool=tool, joints=", ".join(joints), last=joints[-1], rows=len(lines) - 1, data=folder / "given.csv"
    )
    (folder / "config.yaml").write_text(text, encoding="utf-8")
    robot = load_robot(str(folder / "robot.urdf"), str(folder))
    work = Positions(robot, str(folder / "config.yaml"))
    work.calib_config["known_baseframe"] = work.calib_config["known_tipframe"] = False
    work.initialize()
    work.solve(max_iterations=ITERATIONS, outlier_threshold=OUTLIER, enable_logging=False)
    return work


def predict(work: Positions, file: Path, register: bool) -> list[float]:
    """Return the distance of every later row from what the parameters predict. [mm]"""
    flat, q = load_data(str(file), work.model, work.calib_config)
    measured = flat.reshape(3, -1).T
    var = np.asarray(work.LM_result.x)
    model = calc_updated_fkm(work.model, work.data, var, q, work.calib_config).reshape(3, -1).T
    if register:
        a, b = model.mean(axis=0), measured.mean(axis=0)
        u, _, v = np.linalg.svd((model - a).T @ (measured - b))
        turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
        model = (model - a) @ turn.T + b
    return [round(1e3 * float(d), 5) for d in np.linalg.norm(model - measured, axis=1)]


def main() -> None:
    """Calibrate one case and write its answer."""
    warnings.simplefilter("ignore")
    folder, tool, register = Path(sys.argv[1]), sys.argv[2], "--register" in sys.argv[3:]
    start = time.process_time()
    work = calibrate(folder, tool)
    seconds = time.process_time() - start
    left = np.asarray(work.cost_function(np.asarray(work.LM_result.x))).reshape(3, -1)
    answer = {
        "after_rms_mm": float(np.sqrt(np.mean(np.sum(left**2, axis=0)))),
        "parameters": len(work.calib_config["param_name"]),
        "seconds": seconds,
        "fresh": predict(work, folder / "fresh.csv", register),
    }
    (folder / "answer.json").write_text(json.dumps(answer) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
