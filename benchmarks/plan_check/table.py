"""Show the results: a table for the terminal, and markdown for the README."""

from __future__ import annotations

from pathlib import Path

COLUMNS = (
    "job", "answer", "claimed at", "true at", "claimed between", "joint-linear", "Cartesian", "spline", "feed",
    "force off N", "v / a", "effort", "correction", "verdict",
)  # fmt: skip
NOTE = (
    "Lengths in mm. answer: status of plan.json. at: greatest deviation at waypoints of cuts. between: greatest "
    "distance of the loaded tip from the CAM path between waypoints, joints.csv interpolated three ways. feed: least "
    "share (but for first and last moves) and mean share of the programmed feed, by differences of time_s. force: "
    "greatest difference of joints.csv from the force law at that feed. v / a: velocity and acceleration by "
    "differences, as shares of the limits. effort: static joint torque against the URDF's. correction: greatest one, "
    "and the limit. Of paths with more than {rows} cut rows or {moves} moves the worst half (by jumps of force, by how "
    "far the joint move bows) and an even sample of the others are brought to rest."
)


def row_of(result: dict) -> list[str]:
    """Return the cells of one job."""
    claim, truth = result["claim"] or {}, result["truth"]
    status = claim.get("status") or {None: "no answer"}.get(result["exit_status"], f"exit {result['exit_status']}")
    answer = status if result["expected"] in ("any", "solved") else f"{status} (expected: refused)"
    head = [result["job"], answer, _mm(claim.get("after_mm"))]
    if truth is None:
        return [*head, "", "", "", "", "", "", "", "", "", "", result["verdict"]]
    ways = [_mm(truth[f"between_{way}_mm"]) for way in ("joint", "cartesian", "spline")]
    feed = f"{truth['feed_least_share']:.2f} / {truth['feed_mean_share']:.2f}"
    rates = f"{truth['velocity_ratio']:.2f} / {truth['acceleration_ratio']:.2f}"
    correction = f"{truth['correction_mm']:.2f} of {truth['most_correction_mm']:g}"
    figures = [feed, f"{truth['force_off_N']:.3g}", rates, f"{truth['effort_ratio']:.2f}", correction]
    return [*head, _mm(truth["at_mm"]), _mm(claim.get("between_mm")), *ways, *figures, result["verdict"]]


def print_table(results: list[dict]) -> None:
    """Print the table and what was found of each job."""
    rows = [list(COLUMNS), *(row_of(result) for result in results)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    for result in results:
        if result["breaches"]:
            print(f"\n{result['job']}: " + "; ".join(result["breaches"]))


def write_markdown(results: list[dict], file: Path) -> None:
    """Write the table as markdown, with the breaches of each job below it."""
    from benchmarks.plan_check.measure import MOST_MOVES, MOST_ROWS

    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(row_of(result)) + " |" for result in results]
    lines += ["", NOTE.format(rows=MOST_ROWS, moves=MOST_MOVES), ""]
    for result in results:
        if result["breaches"] or result["exit_status"]:
            lines.append(f"- `{result['job']}`: {'; '.join(result['breaches']) or result['said']}")
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _mm(value: float | None) -> str:
    if value is None:
        return "not said"
    if value < 5e-7:
        return "0"
    return f"{value:.3g}" if value < 1 else f"{value:.2f}"
