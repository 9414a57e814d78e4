"""What a run on arms in motion says: a line a job; a table by thirds of speed, by verdict, of what is solved."""

from __future__ import annotations

import numpy as np

from benchmarks.simulated_robot.robot import Array

#: Redraws of the jobs that tell how surely a share is known.
REDRAWS = 400


def describe_job(one: dict) -> str:
    """Return the line of a job: what it claims, and the share of true tips in its band."""
    found, said = one["found"], f"{one['plan_s']:5.0f} + {one['swing_s']:3.0f} s"
    head = f"{one['seed']:4} {one['robot']:<20}{one['status']!s:<14}{one['verdict']!s:<13}"
    if found is None:
        return f"{head}tolerance {one['tolerance_mm']:5.2f}  {said}  {one['said'][:60]}"
    ratio = np.array(found["away_mm"]) / np.array(found["band_mm"])
    beyond = np.mean(np.array(found["greatest_mm"]) > one["tolerance_mm"])
    return (
        f"{head}tolerance {one['tolerance_mm']:5.2f}  band {one['band_mm']:6.2f} mm  beyond {100 * beyond:3.0f} %"
        f"  held {100 * np.mean(ratio <= 1):5.1f} %  true / band {np.quantile(ratio, 0.95):.2f}  {said}"
    )


def describe_table(results: list[dict]) -> str:
    """Return the table of a run."""
    seeds = f"{results[0]['seed']} to {results[-1]['seed']}"
    solved = [one for one in results if one["status"] == "solved"]
    lines = [f"seeds {seeds}: {len(results)} jobs, solved {len(solved)} ({100 * len(solved) / len(results):.0f} %)"]
    for name, feeds, jobs, held, width, point in list_coverage(solved):
        lines.append(f"{name:<7}{feeds:>14} mm/s, {jobs:2} jobs: held {held} % (+- {width}),"
                     f" true 95 % point / band {point}")  # fmt: skip
    for word, jobs, mean, most in list_verdicts(solved):
        lines.append(f"{word:<13}{jobs:3} jobs: tip beyond the tolerance in {mean} % of the arms, in {most} % of the"
                     " worst job's")  # fmt: skip
    return "\n".join(lines)


def list_coverage(jobs: list[dict]) -> list[tuple[str, str, int, str, str, str]]:
    """Return a row a third of speed: name, speeds [mm/s], jobs, share held, its width [%], true 95 % point / band."""
    found = [job["found"] for job in jobs if job["found"] is not None]
    if not found:
        return []
    feed = [np.array(one["feed_mm_s"]) for one in found]
    ratio = [np.array(one["away_mm"]) / np.array(one["band_mm"]) for one in found]
    edges = np.quantile(np.concatenate(feed), [0.0, 1 / 3, 2 / 3, 1.0])
    rows = []
    for k, name in enumerate(("slow", "middle", "fast")):
        inside = [(one >= edges[k]) & (one <= edges[k + 1]) for one in feed]
        mine = [own[:, chosen] for own, chosen in zip(ratio, inside, strict=True) if chosen.any()]
        held, width = count_held(mine)
        point = np.quantile(np.concatenate([own.ravel() for own in mine]), 0.95)
        rows.append((name, f"{edges[k]:.0f} to {edges[k + 1]:.0f}", len(mine), f"{held:.1f}", f"{width:.1f}",
                     f"{point:.2f}"))  # fmt: skip
    return rows


def list_verdicts(jobs: list[dict]) -> list[tuple[str, int, str, str]]:
    """Return a row a verdict: word, jobs, share of the arms with a tip beyond the tolerance, of the worst job's [%]."""
    rows = []
    for word in ("keeps", "may_not_keep", "not_known"):
        own = [job for job in jobs if job["verdict"] == word and job["found"] is not None]
        if own:
            beyond = [100 * np.mean(np.array(job["found"]["greatest_mm"]) > job["tolerance_mm"]) for job in own]
            rows.append((word, len(own), f"{np.mean(beyond):.1f}", f"{max(beyond):.0f}"))
    return rows


def count_held(ratios: list[Array]) -> tuple[float, float]:
    """Return the share of tips within the band, and how surely it is known: two deviations over redrawn jobs. [%]"""
    held, size = (np.array(values, float) for values in ([(r <= 1).sum() for r in ratios], [r.size for r in ratios]))
    draw = np.random.default_rng(0).integers(len(held), size=(REDRAWS, len(held)))
    return 100 * float(held.sum() / size.sum()), 200 * float(np.std(held[draw].sum(axis=1) / size[draw].sum(axis=1)))
