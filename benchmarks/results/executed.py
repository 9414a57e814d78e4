"""Programs as drawn controllers execute them: what a trace identifies, and whether plans keep their word."""

from __future__ import annotations

import numpy as np

from benchmarks.executed.job import compare_logs, draw_shop, identify_shop, run_job
from benchmarks.results.findings import Findings, Settings, draw_table

TITLE = "Executed programs: emulated controllers"
QUESTION = (
    "Does a controller that nobody tells us about take the loaded tip where a plan says, once `compplan trace` has "
    "seen two of its paths?"
)
METHOD = (
    "`benchmarks/executed` draws a controller (zones, look-ahead, acceleration and smoothing, a position loop with "
    "feed-forward and a velocity loop for each joint, dry friction) of three makes; it was written from the makers' "
    "published descriptions by someone who had not read compplan's model of a controller, reads written programs "
    "(RAPID, KRL, URScript) as text, and shares no code with the package. Each controller is traced on two paths (40 "
    "and 90 mm/s, 2 mm zones, noise, torn rows); the model is held against the first path again and at 65 and 120 "
    "mm/s, another path and another posture. Then jobs near by (2 to 4 corners, 10 to 80 mm/s, tolerance 0.13 to 0.63 "
    "mm, a force) are planned with the robot folder that `compplan trace` wrote, the program is executed, and the tip, "
    "bent by force and inertia in MuJoCo, is held against the CAM path, 1.5 mm at both ends left out. One job of each "
    "cell is planned a second time with the folder that nobody traced."
)
LIMITS = (
    "The controllers are emulated. No real one has run these programs.",
    "Arm and force are as modelled: what is not known of them is the matter of other pages.",
    "What is drawn where makers publish nothing (form and share of blends, look-ahead, gains) is assumed.",
)
#: Controllers, three or four of each make, and jobs of each.
SHOPS, JOBS = 11, 3
#: What the model may leave of the distance without it, on the paths that it was fitted to.
AIM = 1 / 3
JOB_HEAD = ("cell", "language", "folder", "tolerance mm", "plan", "said mm", "executed mm", "95 %", "s")


def measure(settings: Settings) -> Findings:
    """Draw the cells, trace them, and run the jobs."""
    logs, jobs, plain, rows = [], [], [], []
    for seed in range(SHOPS):
        place = settings.work / str(seed)
        place.mkdir(parents=True, exist_ok=True)
        shop = draw_shop(place, seed)
        folder, _ = identify_shop(shop, seed, place)
        held = compare_logs(shop, seed, folder, place)
        done = [run_job(shop, folder, 100 * seed + k, place) for k in range(JOBS)]
        plain.append(run_job(shop, shop.folder, 100 * seed, place))
        logs, jobs = [*logs, *held], [*jobs, *done]
        rows += [_show(seed, shop.make, job, "traced") for job in done]
        rows.append(_show(seed, shop.make, plain[-1], "not traced"))
        print(seed, shop.make, rows[-JOBS - 1 :], flush=True)
    kept = [job["executed"] <= job["tolerance"] for job in jobs if says_so(job)]
    short = [
        f"{sum(kept)} of {len(kept)} jobs whose plan says that the executed path is within its tolerance keep it "
        f"({100 * np.mean(kept):.0f} %, aim 95); {len(jobs) - len(kept)} of {len(jobs)} plans do not say so."
    ]
    traced, other = (
        np.array([np.divide(entry["left"], entry["none"]) for entry in logs if (entry["kind"] == "speed") == same])
        for same in (True, False)
    )
    near, worst, far = np.median(traced, axis=0), traced.max(), other.max()
    short.append(
        f"Across the path the model leaves {near[0]:.2f} of the median and {near[1]:.2f} of the 95 % distance without "
        f"it at repeats and other speeds (median of {len(traced)} logs), {worst:.2f} at most (aim 0.33); {far:.2f} at "
        "most on paths and postures that it was not fitted to (aim 1)."
    )
    unsaid = [job["executed"] <= job["tolerance"] for job in plain]
    short.append(
        f"Without a trace, lag not known: {sum(unsaid)} of {len(unsaid)} within the tolerance; their plans say that "
        "path errors of the controller are left out."
    )
    losses = []
    if np.mean(kept) < 0.95:
        losses.append(f"{len(kept) - sum(kept)} of {len(kept)} jobs leave the tolerance that their plan promises.")
    if worst > AIM:
        losses.append(f"{worst:.2f} of the distance is left on one log of a path that was traced.")
    if far > 1.0:
        losses.append(f"The model is worse than none on one log ({far:.2f}).")
    kinds = [[f"{kind} at {1e3 * feed:.0f} mm/s", *_compare(logs, kind, feed)] for kind, feed in
             sorted({(entry["kind"], entry["feed"]) for entry in logs}, reverse=True)]  # fmt: skip
    head = ("log", "without model, median / 95 % mm", "with it", "least and most of the ratios")
    return Findings(
        tuple(short),
        (draw_table(head, kinds), draw_table(JOB_HEAD, rows)),
        tuple(losses),
    )  # fmt: skip


def says_so(job: dict) -> bool:
    """Tell whether a plan says that the executed path is within the tolerance."""
    return job["status"] == "solved" and job["said"] is not None and job["said"] <= job["tolerance"]


def _show(seed: int, make: str, job: dict, folder: str) -> list[str]:
    said = "-" if job["said"] is None else f"{job['said']:.3f}"
    return [str(seed), make, folder, f"{job['tolerance']:.3f}", job["status"], said, f"{job['executed']:.3f}",
            f"{job['p95']:.3f}", f"{job['duration']:.1f}"]  # fmt: skip


def _compare(logs: list[dict], kind: str, feed: float) -> list[str]:
    some = [entry for entry in logs if entry["kind"] == kind and entry["feed"] == feed]
    without, left = (np.median([entry[name] for entry in some], axis=0) for name in ("none", "left"))
    ratios = np.divide([entry["left"] for entry in some], [entry["none"] for entry in some])
    return [f"{without[0]:.3f} / {without[1]:.3f}", f"{left[0]:.3f} / {left[1]:.3f}",
            f"{ratios.min():.2f} to {ratios.max():.2f}"]  # fmt: skip
