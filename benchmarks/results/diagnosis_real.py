"""The diagnosis beside plain rivals on measured robots; rows that chose nothing are the judge."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.contestants import ask_calibration, ask_figaroh, frames_of, miss_figaroh, read_truth
from benchmarks.results.chart import Chart
from benchmarks.results.findings import ROOT, Findings, MissingError, Settings, draw_table, run_benchmark

TITLE = "Diagnosis of measured robots"
QUESTION = "On tracker campaigns of real robots: how far is the updated robot model from poses left out of the fit?"
METHOD = (
    "`--real DIR` names folders with `robot/`, `measurements.csv` and `fresh.csv`. The diagnosis, a plain rival "
    "(greedy, BIC), a plain calibration of all lengths, zeros and compliances and FIGAROH's geometric calibration "
    "(`--figaroh-python`) see `measurements.csv`, whole and thinned by a fixed draw; `fresh.csv` enters no "
    "fit. Frames are fitted to the fresh rows, the same for all."
)
CHART = Chart("error of fresh poses, mm", {
    name: (f"{name}, mm", 0) for name in ("nominal", "compplan", "plain rival", "plain calibration", "FIGAROH")
}, log=True)  # fmt: skip
LIMITS = (
    "The campaigns are published ones and are not part of this project (their licences ask for their notices).",
    "Two robots of one brand, unloaded. Load effects cannot be seen in them.",
    "FIGAROH is given 400 rows at most (it loops over them), and positions less the deflection of the nominal springs.",
    "The causes of a real robot's error are known only in part: names are compared with what others published.",
)
#: The first two are drawn as they have been since the page was first made.
THINNED, SEED = (25, 100, 15, 50), 7
#: Causes that published calibrations of these robots found: effects that name each, and a joint where one was found.
GEOMETRY, WEIGHT = ("link_geometry", "joint_offset"), ("gravity_sag", "joint_stiffness", "link_compliance")
PUBLISHED = {
    "ur10": ((GEOMETRY, ""), (WEIGHT, ""),
             *((("transmission_error",), f"{joint}_joint") for joint in ("shoulder_pan", "shoulder_lift", "elbow"))),
    "ur5": ((GEOMETRY, ""), (WEIGHT, "")),
}  # fmt: skip


def measure(settings: Settings) -> Findings:
    """Ask the diagnosis and the rival about every campaign, whole and thinned."""
    if settings.real is None:
        raise MissingError("needs --real DIR with measured campaigns")
    sources = sorted(file.parent for file in settings.real.glob("*/fresh.csv"))
    if not sources:
        raise MissingError(f"no fresh.csv below {settings.real}")
    for source in sources:
        _cut_cases(source, settings.work / "suite")
    run_benchmark("benchmarks.diagnosis", settings.work / "suite", "--product-tree", ROOT,
                  "--name", "compplan", "--out", settings.work / "scores")  # fmt: skip
    missed = miss_figaroh(settings.figaroh)
    rows, ratio, stated, found, silent = [], [], [], [], [f"FIGAROH: not run: {missed}."] if missed else []
    for case in sorted((settings.work / "suite").iterdir()):
        name, ours = case.name, _read(settings.work / "scores" / "compplan", case)
        if "fresh_updated" not in ours:
            silent.append(f"{name}: no answer, {ours.get('error', 'not known why')}.")
            continue
        rival = _read(settings.work / "scores" / "rival", case)
        fresh, other = _rms(ours["fresh_updated"]), _rms(rival["fresh_updated"])
        frames = frames_of(read_truth(case))
        plain = _rms(ask_calibration(case, frames)["fresh_updated"])
        peer = ask_figaroh(case, settings.figaroh, frames) if settings.figaroh and not missed else {}
        figaroh = f"{_rms(peer['fresh_updated']):.3f}" if "fresh_updated" in peer else "-"
        nominal = _rms(ours["fresh_nominal"])
        told = ours["gap"].get("held_out_after_rms_mm") or np.nan
        ratio.append(fresh / min(other, plain))
        stated.append(told / fresh)
        named = ", ".join(
            f"{e['effect']} {e.get('joint') or ''} {e['probability']:.2f}" for e in ours["verdict"]["effects"]
        )
        hits, count = count_published(name, ours["verdict"]["effects"])
        found.append((name, hits, count))
        rows.append((name, f"{nominal:.3f}", f"{fresh:.3f}", f"{other:.3f}", f"{plain:.3f}", figaroh, f"{told:.3f}",
                     ours["verdict"]["status"], named or "-", f"{hits} of {count}"))  # fmt: skip
    words = ("nominal", "compplan", "plain rival", "plain calibration", "FIGAROH", "compplan states")
    head = ("campaign", *(f"{word}, mm" for word in words), "verdict", "named", "published causes named")
    whole = [(hits, count) for name, hits, count in found if name.endswith("_whole")]
    return Findings(
        (
            f"Error at fresh poses over that of the better plain fit: {np.median(ratio):.2f} in the median of "
            f"{len(rows)} campaigns, {max(ratio):.2f} at most{_beside_figaroh(rows)}.",
            f"The stated error is {np.min(stated):.2f} to {np.max(stated):.2f} times the true one, off by "
            f"{100 * np.median(np.abs(np.array(stated) - 1.0)):.0f} % in the median.",
            f"Of the causes that others published for these robots {sum(h for h, _ in whole)} of "
            f"{sum(c for _, c in whole)} are named from whole campaigns, {sum(h for _, h, _ in found)} of "
            f"{sum(c for _, _, c in found)} from all of them.",
        ),
        (draw_table(head, rows),),
        tuple(silent)
        + tuple(
            f"{row[0]}: {row[2]} mm, the plain rival {row[3]} mm, the plain calibration {row[4]} mm."
            for row, r in zip(rows, ratio, strict=True)
            if r > 1.05
        )
        + tuple(
            f"{row[0]}: {row[6]} mm stated, {row[2]} mm true." for row, s in zip(rows, stated, strict=True) if s < 0.8
        ),
    )


def _beside_figaroh(rows: list[tuple[str, ...]]) -> str:
    """Say how the error compares with FIGAROH's; "" where that gave no answer."""
    ratio = [float(row[2]) / float(row[5]) for row in rows if row[5] != "-"]
    return f"; over FIGAROH's {np.median(ratio):.2f} and {max(ratio):.2f}" if ratio else ""


def count_published(name: str, claims: list[dict[str, Any]]) -> tuple[int, int]:
    """Count the published causes of a campaign's robot that are named, and all of them; 0 of 0 where none is known."""
    causes = PUBLISHED.get(name.partition("_")[0], ())
    told = [(claim["effect"], claim.get("joint")) for claim in claims]
    hits = [any(effect in effects and joint in ("", at) for effect, at in told) for effects, joint in causes]
    return sum(hits), len(hits)


def _cut_cases(source: Path, suite: Path) -> None:
    """Write a campaign whole and thinned as cases of a suite."""
    lines = (source / "measurements.csv").read_text("utf-8").splitlines()
    count = len(lines) - 1
    random = np.random.default_rng(SEED)
    parts = {"whole": np.arange(count)}
    parts |= {f"{n:04d}": np.sort(random.choice(count, n, replace=False)) for n in THINNED if n < count}
    for part, rows in parts.items():
        case = suite / f"{source.name}_{part}"
        shutil.copytree(source / "robot", case / "robot", dirs_exist_ok=True)
        shutil.copy(source / "fresh.csv", case / "fresh.csv")
        (case / "measurements.csv").write_text("\n".join([lines[0], *(lines[1 + k] for k in rows)]) + "\n", "utf-8")
        truth = {"kind": "real", "effects": [], "background": [], "register": {"given": "not known"}}
        (case / "truth.json").write_text(json.dumps(truth) + "\n", "utf-8")


def _read(folder: Path, case: Path) -> dict:
    return json.loads((folder / f"{case.parent.name}__{case.name}.json").read_text("utf-8"))


def _rms(values: list[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known))))
