"""The chain from a CAM file to a program: one path as G-code, APT, KRL and RAPID, written in every language.

    python -m benchmarks.cam_chain [--from gcode apt krl rapid] [--to krl rapid ..]

Every program is read back by the readers of the tests, which share nothing with the writers. Joints are held against
joints.csv, counted by hand as tests/support/golden_cell.py says; Cartesian positions against forward kinematics
written out there; configuration, tool, base, external axes, and what is switched on the way, against the definitions.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path.insert(0, str(TESTS))

import golden_cell as cell  # noqa: E402
from program_moves import Move, Pose, shift, turn  # noqa: E402

from tests.controllers.test_golden_programs import FORMS, place_tip, read_form  # noqa: E402

INPUTS = {"gcode": ".mpf", "apt": ".apt", "krl": ".src", "rapid": ".mod"}
LANGUAGES = tuple(cell.COUNTING)
#: Last digit of a joint [deg] and of an external axis [mm] in each language.
DIGITS = {"urscript": math.degrees(1e-9), "csv": 1e-9}
DIGIT, RAIL_DIGIT = 1e-6, {"krl": 1e-4, "rapid": 1e-5, "sinumerik": 1e-5}
#: What the issue asks of Cartesian positions. [mm, deg]
FARTHEST, MOST_TURN = 1e-4, 1e-5
#: What happens: before the first move, after the second waypoint, at the end; with output 3 for the spindle.
IO = "io = { spindle = 3, spindle_wait_s = 4.0, signals = { \"$OUT[3]\" = 3, DO3 = 3 } }\n"


@dataclass(frozen=True)
class Row:
    """What one program shows: greatest errors, and whether everything else is as it has to be."""

    source: str
    form: str
    moves: int
    joint: float
    position: float
    rotation: float
    rail: float
    faults: tuple[str, ...]


# ------------------------------------------------------------------------------------------------ the path, four times


def point_tool(axis: np.ndarray) -> np.ndarray:
    """Rotation of the TCP frame in the part: z against the tool axis, x as near to the part's z as it can be."""
    z = -axis / np.linalg.norm(axis)
    x = np.array([0.0, 0, 1]) - z * z[2]
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def write_gcode(points: np.ndarray) -> str:
    lines = ["%_N_CUT_MPF", "G21 G90 G17", "TRAORI", "; golden path"]
    for number, (x, y, z, i, j, k, rapid) in enumerate(points.tolist()):
        word = "G0" if rapid else f"G1 F{cell.FEED * 60!r}"
        lines.append(f"{word} X{x!r} Y{y!r} Z{z!r} A3={i!r} B3={j!r} C3={k!r}")
        lines += ["S9000 M3"] if number == 0 else ["G4 F2"] if number == 2 else []
    return "\n".join([*lines, "M5", "M30", ""])


def write_apt(points: np.ndarray) -> str:
    lines = ["PARTNO GOLDEN PATH", "UNITS/MM", "MULTAX/ON", f"FEDRAT/{cell.FEED * 60!r},MMPM"]
    for number, (x, y, z, i, j, k, rapid) in enumerate(points.tolist()):
        lines += ["RAPID"] if rapid else []
        lines.append(f"GOTO/{x!r},{y!r},{z!r},{i!r},{j!r},{k!r}")
        lines += ["SPINDL/9000,CLW"] if number == 0 else ["DELAY/2"] if number == 2 else []
    return "\n".join([*lines, "SPINDL/OFF", "FINI", ""])


def write_krl(points: np.ndarray) -> str:
    lines = ["DEF cut()", "; golden path", "BAS(#INITMOV,0)", "$BASE={X 5,Y 6,Z 7,A 0,B 0,C 0}"]
    lines.append(f"$VEL.CP={cell.FEED * 1e-3!r}")
    for number, (x, y, z, *axis, rapid) in enumerate(points.tolist()):
        r = point_tool(np.array(axis))
        b = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
        a, c = math.atan2(r[1, 0], r[0, 0]), math.atan2(r[2, 1], r[2, 2])
        angles = ",".join(f"{name} {math.degrees(value)!r}" for name, value in zip("ABC", (a, b, c), strict=True))
        lines.append(f"{'PTP' if rapid else 'LIN'} {{X {x!r},Y {y!r},Z {z!r},{angles}}}{'' if rapid else ' C_DIS'}")
        lines += ["$OUT[3]=TRUE"] if number == 0 else ["WAIT SEC 2"] if number == 2 else []
    return "\n".join([*lines, "$OUT[3]=FALSE", "END", ""])


def write_rapid(points: np.ndarray) -> str:
    lines = ["MODULE cut", "PROC main()", "! golden path"]
    for number, (x, y, z, *axis, rapid) in enumerate(points.tolist()):
        r = point_tool(np.array(axis))
        vector = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        w = 0.5 * math.sqrt(max(1.0 + np.trace(r), 0.0))
        if w > 1e-3:
            q = [w, *(vector / (4 * w)).tolist()]
        else:
            values, vectors = np.linalg.eigh(r + r.T)
            q = [0.0, *vectors[:, np.argmax(values)].tolist()]
        target = f"[[{x!r},{y!r},{z!r}],[{','.join(map(repr, q))}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
        speed = "v1000" if rapid else f"[{cell.FEED!r},500,5000,1000]"
        word, zone = ("MoveJ", "fine") if rapid else ("MoveL", "z1")
        lines.append(f"{word} {target},{speed},{zone},tMill\\WObj:=wPart;")
        lines += ["SetDO do3,1;"] if number == 0 else ["WaitTime 2;"] if number == 2 else []
    return "\n".join([*lines, "SetDO do3,0;", "ENDPROC", "ENDMODULE", ""])


WRITE = {"gcode": write_gcode, "apt": write_apt, "krl": write_krl, "rapid": write_rapid}


def run_chain(source: str, language: str, folder: Path) -> list[Row]:
    """Write the path in a CAM language, plan it, write the program, and judge what its readers say."""
    job = cell.write_job(folder, language)
    points = cell.WAYPOINTS.copy()
    points[:, 3:6] /= np.linalg.norm(points[:, 3:6], axis=1)[:, None]
    (folder / f"cut{INPUTS[source]}").write_text(WRITE[source](points))
    text = job.read_text().replace("path.csv", f"cut{INPUTS[source]}")
    job.write_text(text + IO + '[cam]\ntool_direction = "z"\n')
    status, said = run_command("plan", str(job), "--out", str(folder / "out"))
    if status:
        return [Row(source, language, 0, math.inf, math.inf, math.inf, math.inf, (said[-200:],))]
    planned = read_joints(folder / "out" / "joints.csv", cell.COUNTING[language].rail)
    forms = [form for form in FORMS if form.split()[0] == language]
    return [judge_form(source, form, read_form(form, folder / "out", "golden"), planned) for form in forms]


def run_command(*words: str) -> tuple[int, str]:
    """Run a command of compplan in this process; return its exit status and what it said."""
    from compplan.cli import main as compplan

    said, before = io.StringIO(), sys.argv
    sys.argv = ["compplan", *words]
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            compplan()
    except SystemExit as done:
        return int(done.code or 0), said.getvalue().strip()
    finally:
        sys.argv = before
    return 0, said.getvalue().strip()


# ---------------------------------------------------------------------------------------------------------- the judge


def read_joints(file: Path, rail: bool) -> np.ndarray:
    """Return slide [mm] and angles [deg] of the rows of the path, approach and retract left out. Shape (n, 7)."""
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    names = (["q1_mm"] if rail else []) + [f"q{k}_deg" for k in range(1 + rail, 7 + rail)]
    table = np.array([[float(row[name]) for name in names] for row in rows if row["move"] in ("cut", "rapid")])
    return table if rail else np.column_stack([np.zeros(len(table)), table])


def count(language: str, planned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the controller shows: rails (n, 1 or 0) and arms (n, 6), by undoing its affine rule."""
    counting = cell.COUNTING[language]
    size = 6 + counting.rail

    def undo(shown: np.ndarray) -> np.ndarray:
        arm = tuple(shown[-6:].tolist())
        return np.array(counting.undo(arm, float(shown[0]) if counting.rail else None))[-size:]

    zero = undo(np.zeros(size))
    matrix = np.column_stack([undo(unit) - zero for unit in np.eye(size)])
    shown = np.linalg.solve(matrix, (planned[:, -size:] - zero).T).T
    return shown[:, : size - 6], shown[:, size - 6 :]


def word_of(angles: np.ndarray) -> tuple[bool, bool, bool]:
    """Return whether the wrist centre is behind axis 1, the elbow down, the wrist flipped (golden_cell)."""
    arm = turn("y", -angles[1]) @ shift(0, 0, 800) @ turn("y", -angles[2]) @ shift(700, 0, 0)
    return 300.0 + arm[0, 3] < 0.0, bool(angles[2] >= 90.0), bool(angles[4] >= 5.0)


def configure(language: str, angles: np.ndarray, arm: np.ndarray) -> tuple[object, ...]:
    """Return the configuration that a position has to carry."""
    back, down, flip = word_of(angles)
    status = (1 if back else 0) + (0 if down else 2) + (4 if flip else 0)
    bits = sum(1 << k for k in range(6) if arm[k] < 0.0)
    turns = [str(math.floor((arm[k] + 180) / 360)) for k in (0, 3, 5)]
    return {
        "krl": (status, bits),
        "fanuc_ls": ("F" if flip else "N", "D" if down else "U", "B" if back else "T", *turns),
        "rapid": (*(math.floor(arm[k] / 90) for k in (0, 3, 5)), 4 * back + 2 * down + flip),
        "val3": ("lefty" if back else "righty", "enegative" if down else "epositive",
                 "wnegative" if flip else "wpositive"),
        "inform": (int(not flip), int(down), int(back), *(int(arm[k] >= 180) for k in (3, 5, 0))),
    }.get(language, ())  # fmt: skip


def judge_form(source: str, form: str, moves: list[Move], planned: np.ndarray) -> Row:
    """Hold the moves of a program against the plan."""
    language = form.split()[0]
    faults: list[str] = []
    path = [move for move in moves if move.kind != "act"]
    rails, arms = count(language, planned)
    tips = [cell.forward(row[0], tuple(row[1:])) @ cell.TOOL for row in planned.tolist()]
    offset = (len(path) - len(planned)) // 2
    if len(path) < len(planned) or offset < 0:
        faults.append(f"{len(path)} moves for {len(planned)} waypoints")
    joint = position = rotation = rail = 0.0
    for k, tip in enumerate(tips):
        move = path[offset + k]
        if move.external and rails.size:
            rail = max(rail, abs(move.external[0] - rails[k, 0]))
        if move.joints is not None:
            joint = max(joint, float(np.abs(np.array(move.joints) - arms[k]).max()))
        else:
            found = place_tip(language, move)
            position = max(position, float(np.abs(found[:3, 3] - tip[:3, 3]).max()))
            rotation = max(rotation, angle_between(found, tip))
            wanted = configure(language, planned[k, 1:], arms[k])
            if wanted and not move.flange_turn and move.configuration != wanted:
                faults.append(f"waypoint {k}: configuration {move.configuration}, not {wanted}")
            base = np.linalg.inv(cell.COUNTING[language].world) @ cell.PART
            if np.abs(np.asarray(move.base) - base).max() > 1e-4:
                faults.append(f"waypoint {k}: base")
        if FORMS[form][2] and (move.tool is None or np.abs(move.tool - cell.TOOL).max() > 1e-4):
            faults.append(f"waypoint {k}: tool")
    faults += judge_actions(form, moves)
    limit = 0.5 * DIGITS.get(language, DIGIT) * (1 + 1e-3) + 2e-9
    within = joint <= limit and position <= FARTHEST and rotation <= MOST_TURN
    if not within or rail > 0.5 * RAIL_DIGIT.get(language, DIGIT) * (1 + 1e-3) + 2e-9:
        faults.append("errors")
    return Row(source, form, len(path), joint, position, rotation, rail, tuple(dict.fromkeys(faults)))


def judge_actions(form: str, moves: list[Move]) -> list[str]:
    """Return what is wrong with what is switched: spindle on before the first cut, the dwell within, off at the end."""
    if form.startswith("csv"):
        return []
    done = [move.action for move in moves if move.kind == "act"]
    spins = "cw" if any(action[0] == "cw" for action in done) else "on"
    names = [str(action[0]) for action in done]
    order = [name for name in names if name in (spins, "wait", "off", "stop")]
    wanted = ([spins, "wait", "wait", "off"], [spins, "wait", "stop"], [spins, "wait", "off"])
    faults = [] if order in wanted else [f"actions {names}"]
    turning = False
    for move in moves:
        if move.kind == "act":
            turning = move.action[0] == spins or (turning and move.action[0] not in ("off", "stop"))
        elif move.kind == "line" and not turning:
            faults.append("a cut with the spindle stopped")
    return faults


def angle_between(one: Pose, other: Pose) -> float:
    """Return the angle between two rotations [deg]."""
    r = one[:3, :3].T @ other[:3, :3]
    vector = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
    return math.degrees(math.atan2(math.hypot(*vector), float(np.trace(r)) - 1.0))


def format_rows(rows: list[Row]) -> str:
    """Return the table."""
    heads = f"{'joint deg':>10} {'tip mm':>9} {'turn deg':>9} {'rail mm':>9}"
    lines = [f"{'from':6} {'program':19} {'moves':>5} {heads}  rest"]
    for row in rows:
        figures = f"{row.joint:10.1e} {row.position:9.1e} {row.rotation:9.1e} {row.rail:9.1e}"
        rest = "; ".join(row.faults)[:90] or "as it has to be"
        lines.append(f"{row.source:6} {row.form:19} {row.moves:5d} {figures}  {rest}")
    return "\n".join(lines)


def main() -> int:
    """Run the command; return the exit status."""
    parser = argparse.ArgumentParser(description="From CAM files to programs in every language, and back.")
    parser.add_argument("--from", dest="sources", nargs="+", choices=[*INPUTS], default=[*INPUTS])
    parser.add_argument("--to", dest="languages", nargs="+", choices=LANGUAGES, default=LANGUAGES)
    given = parser.parse_args()
    rows: list[Row] = []
    for source in given.sources:
        for language in given.languages:
            with tempfile.TemporaryDirectory() as folder:
                rows += run_chain(source, language, Path(folder))
                print(f"{source} to {language}", file=sys.stderr, flush=True)
    print(format_rows(rows))
    wrong = sum(bool(row.faults) for row in rows)
    print(f"{len(given.sources) * len(given.languages)} programs in {len(rows)} forms, {wrong} not as they have to be")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
