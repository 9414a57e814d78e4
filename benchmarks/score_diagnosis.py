# ruff: noqa: E501, RUF007
"""Score diagnoses of simulated campaigns whose truth is known.

    python benchmarks/score_diagnosis.py FOLDER.. --out DIR [--only PATTERN] [--report]

Each FOLDER holds campaigns (robot/, measurements.csv, fresh.csv, truth.json). Every campaign is diagnosed without
sight of its
truth, the fresh campaign is predicted with the updated robot, and the answers are compared with the truth afterwards.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from compplan.diagnose import diagnose_campaign
from compplan.measurements import read_campaign
from compplan.predict import predict_campaign
from compplan.robot import load_robot
from compplan.robot_folder import read_robot_folder, write_robot_folder

BINS = (0.0, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)


def diagnose_case(folder: Path, out: Path) -> dict[str, Any]:
    """Diagnose one campaign and predict its fresh one; what is written is all that scoring reads."""
    robot = load_robot(folder / "robot")
    campaign = read_campaign(folder / "measurements.csv", robot)
    start, cpu = time.perf_counter(), time.process_time()
    diagnosis = diagnose_campaign(robot, campaign)
    answer = diagnosis.to_table()
    answer["seconds"], answer["cpu_seconds"] = time.perf_counter() - start, time.process_time() - cpu
    write_robot_folder(diagnosis.updated, out / "robot")
    updated = read_robot_folder(out / "robot")
    fresh = read_campaign(folder / "fresh.csv", robot)
    for name, model in (("nominal", robot), ("updated", updated)):
        gap = fresh.position - predict_campaign(model, fresh).position
        answer[f"fresh_{name}"] = np.linalg.norm(gap, axis=1).tolist()
    (out / "answer.json").write_text(json.dumps(answer))
    return answer


def same(claim: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Tell whether a claim names a true effect and its place."""
    if claim["effect"] != truth["effect"] or claim["joint"] != truth["joint"]:
        return False
    return truth.get("axis") is None or claim["axis"] is None or claim["axis"] == truth["axis"]


def accepts(claim: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Tell whether a claim names a true effect or one that the campaign cannot tell from it."""
    return same(claim, truth) or any(same(claim, other) for other in truth.get("acceptable", []))


def score_case(truth: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """Compare one answer with the truth."""
    claims = answer["verdict"]["effects"]
    known = [e for e in truth["effects"] if e.get("in_vocabulary", True)]
    found = [any(accepts(c, e) for c in claims) for e in known]
    right = [any(accepts(c, e) for e in known) for c in claims]
    real = [r or any(same(c, b) for b in truth["background"]) for c, r in zip(claims, right, strict=True)]
    ties = listed = idle = rivals = 0
    for e in known:
        acceptable = [a for a in e.get("acceptable", []) if a["effect"] != e["effect"]]
        for c in (c for c in claims if accepts(c, e)):
            rivals += len(c["ambiguous_with"])
            idle += sum(not (accepts(r, e)) for r in c["ambiguous_with"])
            if acceptable:
                ties += 1
                listed += any(accepts(r, e) for r in c["ambiguous_with"])
    outliers = set(truth["split"]["fresh"].get("outlier_rows", []))
    keep = [k for k in range(len(answer["fresh_updated"])) if k not in outliers]
    floor = truth["noise_floor_rms_mm"]
    rms = {
        n: 1e3 * float(np.sqrt(np.nanmean(np.array(answer[f"fresh_{n}"])[keep] ** 2))) for n in ("nominal", "updated")
    }
    return {
        "case": truth["case"], "kind": truth["kind"], "difficulty": truth.get("difficulty", ""),
        "all": all(found) and bool(found), "false": sum(not r for r in real), "claims": len(claims),
        "right": sum(real), "status": answer["verdict"]["status"], "expected": truth["expected_status"],
        "probabilities": [(c["probability"], r) for c, r in zip(claims, real, strict=True)],
        "ties": ties, "listed": listed, "rivals": rivals, "idle": idle,
        "fresh": rms["updated"] / floor, "fresh_nominal": rms["nominal"] / floor, "seconds": answer["seconds"],
        "cpu": answer["cpu_seconds"],
    }  # fmt: skip


def summarize(scores: list[dict[str, Any]]) -> str:
    """Write the figures as text."""
    lines = []
    for kind in sorted({s["kind"] for s in scores}):
        for difficulty in sorted({s["difficulty"] for s in scores}):
            part = [s for s in scores if s["kind"] == kind and s["difficulty"] == difficulty]
            if not part:
                continue
            n = len(part)
            lines.append(
                f"{kind:18s} {difficulty:10s} n {n:3d}  all named {sum(s['all'] for s in part):3d}  nothing false "
                f"{sum(s['false'] == 0 for s in part):3d}  false names {sum(s['false'] for s in part):3d}  status right "
                f"{sum(s['status'] == s['expected'] for s in part):3d}  fresh/floor median "
                f"{np.median([s['fresh'] for s in part]):.2f} worst {max(s['fresh'] for s in part):.2f} "
                f"(nominal {np.median([s['fresh_nominal'] for s in part]):.1f}, "
                f"worse {sum(s['fresh'] > 1.001 * s['fresh_nominal'] for s in part)})"
            )
    claims = [p for s in scores for p in s["probabilities"]]
    if claims:
        p, r = np.array([c[0] for c in claims]), np.array([c[1] for c in claims], float)
        lines.append(
            f"precision of claims {r.mean():.3f} of {len(r)}; confident wrong {np.mean((p > 0.8) & (r == 0)):.3f}"
        )
        error = 0.0
        for low, high in zip(BINS[:-1], BINS[1:], strict=True):
            inside = (p > low) & (p <= high)
            if inside.any():
                error += inside.mean() * abs(p[inside].mean() - r[inside].mean())
                lines.append(
                    f"  {low:.2f}-{high:.2f}: {inside.sum():4d} claims, stated {p[inside].mean():.3f}, right {r[inside].mean():.3f}"
                )
        lines.append(f"expected calibration error {error:.3f}")
    ties, rivals = sum(s["ties"] for s in scores), sum(s["rivals"] for s in scores)
    lines.append(
        f"ties listed {sum(s['listed'] for s in scores)} of {ties}; idle rivals {sum(s['idle'] for s in scores)} of {rivals}"
    )
    lines.append(
        f"seconds: median {np.median([s['seconds'] for s in scores]):.1f}, cpu median {np.median([s['cpu'] for s in scores]):.1f}"
    )
    return "\n".join(lines)


def name(e: dict[str, Any]) -> str:
    """Write an effect shortly."""
    return " ".join(str(part) for part in (e["effect"], e.get("joint"), e.get("axis")) if part)


def main() -> None:
    """Diagnose, score, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default="*")
    parser.add_argument("--report", action="store_true", help="score what is there, diagnose nothing")
    arguments = parser.parse_args()
    scores = []
    for folder in sorted(p.parent for f in arguments.folders for p in f.glob("*/truth.json")):
        if not fnmatch.fnmatch(folder.name, arguments.only):
            continue
        out = arguments.out / folder.name
        out.mkdir(parents=True, exist_ok=True)
        if not (out / "answer.json").is_file() and not arguments.report:
            diagnose_case(folder, out)
        if not (out / "answer.json").is_file():
            continue
        truth, answer = json.loads((folder / "truth.json").read_text()), json.loads((out / "answer.json").read_text())
        score = score_case(truth, answer)
        scores.append(score)
        good = score["false"] == 0 and (score["all"] or not truth["effects"] or score["kind"] == "unknown")
        print(
            ("ok  " if good else "BAD ") + folder.name,
            score["status"],
            f"fresh {score['fresh']:.2f} cpu {score['cpu']:.0f}",
        )
        print("      truth:", "; ".join(name(e) for e in truth["effects"]))
        s = answer["structure_left"]
        for c in [*answer["verdict"]["effects"], *answer["verdict"]["doubtful"], *answer["verdict"]["minor"]]:
            right = any(accepts(c, e) for e in truth["effects"])
            back = any(same(c, b) for b in truth["background"])
            print(f"      {'+' if right else 'b' if back else '-'} {name(c)} p {c['probability']:.2f} explains {c['explained_rms_mm']:.4f}"
                  f" odds {c['log_odds']:.1f} with {[name(r) for r in c['ambiguous_with']]}")  # fmt: skip
        print(f"      structure {s['present']} rms {s['rms_mm']:.4f} gain {s['log_evidence']:.1f} background {s['background_rms_mm']:.4f}"
              f" claims {s['explained_rms_mm']:.4f} floor {truth['noise_floor_rms_mm']:.4f} own {answer['gap']['noise_floor_mm']:.4f}"
              f" held out {answer['gap']['held_out_before_rms_mm']:.4f}>{answer['gap']['held_out_after_rms_mm']:.4f}", flush=True)  # fmt: skip
    print(summarize(scores))


if __name__ == "__main__":
    main()
