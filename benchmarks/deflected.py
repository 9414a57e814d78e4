"""The surface that a yielding arm cuts, beside a simulation in time: `python -m benchmarks.deflected`.

Force, deflection and removal advance together, tooth by tooth: a tooth's chip is what its edge meets of a plane of
small cells and takes away; its force drives an arm with mass, damping and the compliance of the robot at the middle of
the path; where the arm stands is where the next tooth cuts. It knows neither engagement nor averages nor process
stiffness. Compared is where the wall stands in the end with what the product predicts for the uncorrected tool. It
shares the coefficients and the arm's compliance with the product and nothing else.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from compplan.job.job import check_job
from compplan.plan.evaluate import evaluate_model
from compplan.plan.plan import build_task, prepare_job
from compplan.statics.elastic import loaded_compliance

RADIUS, TEETH, RPM, FEED, DEPTH = 5.0, 2, 9000.0, 45.0, 2.0  # mm, -, 1/min, mm/s, mm
CUTTING, EDGE = (800.0, 300.0), (15.0, 12.0)  # tangential, radial [N/mm2, N/mm]
LENGTH, CELL, TURN = 36.0, 0.005, np.radians(1.5)  # of the block [mm], of the plane [mm], a step in time [rad]
BITES = 0.01  # chip from which on the edge force stands in full [mm]
RINGING, DAMPING = 25.0, 0.3  # of the arm [Hz], []: slow beside the teeth, so that only the mean force bends it
#: Passes: y of each, mm; the block fills y < 0, or all of the plane.
CASES = {
    "side, up": ([3.0], "below"),
    "wide, down": ([1.5], "above"),
    "half immersion, up": ([0.0], "below"),
    "two side passes, up": ([3.4, 1.9], "below"),
    "slot": ([0.0], "all"),
}


def simulate(passes: list[float], side: str, compliance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut; return the plane that is left, True where material stands, and the corner of its first cell [mm]."""
    low = np.array([-8.0, -8.0])
    plane = np.zeros((int((LENGTH + 16.0) / CELL), int(18.0 / CELL)), bool)
    x = low[0] + (np.arange(plane.shape[0]) + 0.5) * CELL
    y = low[1] + (np.arange(plane.shape[1]) + 0.5) * CELL
    plane[np.ix_((x > 0) & (x < LENGTH), {"below": y < 0, "above": y > 0, "all": y > -99}[side])] = True
    for at in passes:
        run_pass(plane, low, at, compliance)
    return plane, low


def run_pass(plane: np.ndarray, low: np.ndarray, at: float, compliance: np.ndarray) -> None:
    """Move the cutter through the block once, from left to right."""
    step = TURN / (2 * np.pi * RPM / 60.0)
    reach = 3.0 * FEED / (RPM / 60.0) / TEETH
    rings = RADIUS - (np.arange(int(reach / CELL)) + 0.5) * CELL
    fan = (np.arange(int(np.ceil(RADIUS * TURN / CELL))) + 0.5) / np.ceil(RADIUS * TURN / CELL) * TURN
    away, speed, omega = np.zeros(3), np.zeros(3), 2 * np.pi * RINGING
    for i in range(int((LENGTH + 1.2 * RADIUS) / FEED / step)):
        centre = np.array([-1.1 * RADIUS + FEED * i * step, at]) + away[:2]
        force = np.zeros(3)
        for tooth in range(TEETH):
            angle = -(i * TURN + fan) + 2 * np.pi * tooth / TEETH  # clockwise
            out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            cell = ((centre + out[:, None] * rings[:, None] - low) / CELL).astype(int)
            cell = np.clip(cell, 0, np.array(plane.shape) - 1)
            meets = plane[cell[..., 0], cell[..., 1]]
            if not meets.any():
                continue
            plane[cell[..., 0], cell[..., 1]] = False
            rays, places = np.nonzero(meets)
            first = np.unique(np.ravel_multi_index(tuple(cell[rays, places].T), plane.shape), return_index=True)[1]
            chip = np.bincount(rays[first], minlength=len(fan)) * CELL**2 / (RADIUS * TURN / len(fan))
            along = np.stack([-out[:, 1], out[:, 0]], axis=1)  # the work holds the edge back
            rubs = min(chip.mean() / BITES, 1.0)  # a cell that was missed is no chip yet
            size = [(k * chip + e * rubs) * (DEPTH - away[2]) for k, e in zip(CUTTING, EDGE, strict=True)]
            force[:2] += (size[0][:, None] * along - size[1][:, None] * out).mean(axis=0)
        rush = omega**2 * (1e3 * compliance @ force - away) - 2 * DAMPING * omega * speed
        speed = speed + rush * step
        away = away + speed * step


def find_wall(plane: np.ndarray, low: np.ndarray, x: np.ndarray, side: str, last: float) -> np.ndarray:
    """Return where the wall stands at places [mm], the one that the last pass cut; of a slot that to the left."""
    rows = ((x - low[0]) / CELL).astype(int)
    y = low[1] + np.arange(plane.shape[1]) * CELL
    if side == "below":
        return np.array([y[plane[row]].max() + CELL for row in rows])
    return np.array([y[plane[row] & (y > last)].min() for row in rows])


def predict(passes: list[float], side: str, folder: Path) -> tuple:
    """Return x of the last pass [mm], its deviation to the left with and without coupling [mm], compliance [m/N]."""
    lines, far = ["x_mm,y_mm,z_mm,feed_mm_s,rapid"], LENGTH + 1.1 * RADIUS
    for at in passes:
        lines += [f"{-1.1 * RADIUS},{at},20,{FEED},1", f"{-1.1 * RADIUS},{at},{-DEPTH},{FEED},1",
                  f"{far},{at},{-DEPTH},{FEED},0", f"{far},{at},20,{FEED},1"]  # fmt: skip
    (folder / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    y = {"below": (-40.0, 0.0), "above": (0.0, 40.0), "all": (-40.0, 40.0)}[side]
    job = {
        "schema": 1, "name": "deflected", "robot": "staubli_tx200", "toolpath": "path.csv",
        "part": {"position_mm": [1400.0, 0.0, 300.0], "touched_off": False},
        "process": {"model": "end_mill", "diameter_mm": 2 * RADIUS, "teeth": TEETH, "spindle_rpm": RPM,
                    "coefficients": {"cutting_N_mm2": [*CUTTING, 0.0], "edge_N_mm": [*EDGE, 0.0]},
                    "stock": {"block_mm": [[0.0, y[0], -30.0], [LENGTH, y[1], 0.0]]}},
        "coupling": {"from_model": True}, "plan": {"rotate_about_tool_axis": False},
    }  # fmt: skip
    robot, nominal, options = prepare_job(check_job(job, folder / "job.toml"))
    task = build_task(robot, nominal, options)
    coupled, plain = evaluate_model(task, task.q_start), evaluate_model(task, task.q_start, coupled=False)
    place = task.position - np.array([1.4, 0.0, 0.3])
    mine = np.flatnonzero(~task.nominal.rapid & ~task.lead & (np.abs(1e3 * place[:, 1] - passes[-1]) < 0.01))
    middle = mine[len(mine) // 2]
    compliance = loaded_compliance(task.chain, task.q_start[[middle]], task.wrench[[middle]])[0, :3, :3]
    settled = coupled.settled
    assert settled is not None
    told = f"{settled.passes} passes, ratio {settled.ratio:.2g}" + ("" if settled.agrees else ", do not agree")
    left = [1e3 * side.deviation[mine, 1] for side in (coupled, plain)]
    return 1e3 * place[mine, 0], left[0], left[1], compliance, told


def main() -> int:
    looked = np.linspace(0.45 * LENGTH, 0.8 * LENGTH, 15)
    worst = 0.0
    print("case: wall moved in the simulation | predicted, force where the tool is | force on the path | off by")
    for name, (passes, side) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            x, coupled, plain, compliance, told = predict(passes, side, Path(folder))
        plane, low = simulate(passes, side, compliance)
        wall = find_wall(plane, low, looked, side, passes[-1])
        moved = wall - (passes[-1] + (-RADIUS if side == "below" else RADIUS))
        wanted, without = np.interp(looked, x, coupled), np.interp(looked, x, plain)
        off = float(np.abs(wanted - moved).max() / np.abs(moved).max())
        worst = max(worst, off)
        shown = [1e3 * float(values.mean()) for values in (moved, wanted, without)]
        print(f"{name}: {shown[0]:.1f} um | {shown[1]:.1f} um | {shown[2]:.1f} um | at most {100 * off:.1f} % ({told})")
    print(f"worst: {100 * worst:.1f} % of the deviation, 10 % allowed")
    return int(worst > 0.10)


if __name__ == "__main__":
    sys.exit(main())
