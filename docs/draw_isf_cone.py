"""Draw the README's picture: the robot, and the cone without correction, planned, and planned for the wrong robot."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from robot_picture import draw_robot_flat, project_points

import compplan as cp

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Plan the cone and save docs/isf_cone.png."""
    plan = cp.plan_job(cp.load_job(ROOT / "paths" / "isf_cone.toml"))
    softer = cp.evaluate_run(
        plan.task, plan.q, cp.build_simulated_robot(plan.robot.scale_compliance(1.2), "compliance x 1.2")
    )
    cut = plan.task.compensated
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 5), width_ratios=(1, 1, 1.35), layout="constrained")
    draw_robot_flat(left, plan.robot, plan.q[np.flatnonzero(cut)[0]])
    left.plot(*project_points(plan.task.position[cut]).T, color="#c0392b", linewidth=1.5)
    left.set_aspect("equal")
    left.set_axis_off()
    left.set_title("Staubli TX200 forming a cone", fontsize=12)
    runs = [("no correction", plan.before, "#c0392b"), ("planned, robot 20 % softer", softer, "#e0a030")]
    nominal = 1e3 * plan.task.position[cut]
    middle.plot(nominal[:, 0] - 1500, nominal[:, 1], color="#999999", linewidth=0.5, label="wanted")
    middle.plot(*(1e3 * plan.before.position[cut, :2] - [1500, 0]).T, color="#c0392b", linewidth=0.5, label="loaded")
    middle.set(xlabel="x - 1500 mm", ylabel="y, mm", aspect="equal")
    middle.set_title("Path from above, no correction", fontsize=12)
    middle.legend(loc="upper right", fontsize=8)
    length = 1e3 * plan.task.nominal.arc_length[cut]
    for name, run, colour in [*runs, ("planned, robot as modelled", plan.after, "#2e7fb5")]:
        worst = run.max_deviation * 1e3
        label = f"{name}: up to {worst:.2f} mm" if worst > 1e-3 else f"{name}: below 1 µm"
        right.semilogy(length, np.maximum(1e3 * run.distance[cut], 1e-5), color=colour, linewidth=1, label=label)
    right.set(xlabel="path length, mm", ylabel="deviation of the loaded tip, mm", ylim=(5e-6, 30))
    right.set_title("Exact loaded equilibrium in the virtual cell", fontsize=12)
    right.legend(loc="center right", fontsize=9)
    figure.savefig(Path(__file__).with_name("isf_cone.png"), dpi=110)


if __name__ == "__main__":
    main()
