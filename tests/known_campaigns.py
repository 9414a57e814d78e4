"""Small campaigns whose truth is known, and every number that a diagnosis says of each.

`python tests/known_campaigns.py` writes tests/known_truth.json anew (with names: those campaigns); `--study N` moves N
numbers of the diagnosis, drawn at random, to twice and to half their value and says which of them these campaigns see.
"""

from __future__ import annotations

import ast
import importlib
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from simulated_campaigns import measure, plan_rows, write_small_robot

import compplan.diagnose
from compplan.diagnose import diagnose_campaign
from compplan.effects import Effect
from compplan.measure.campaign import Campaign
from compplan.robot import Robot

FILE = Path(__file__).parent / "known_truth.json"
ROOM = Path(compplan.diagnose.__file__).parent
#: A number is as before within this share, or this much.
SHARE, LITTLE = 0.01, 2e-3


def soft(joint: str, change: float) -> Effect:
    return Effect("joint_stiffness", joint, None, {"compliance_change_rad_per_Nm": change})


def zero(joint: str, offset: float) -> Effect:
    return Effect("joint_offset", joint, None, {"offset_rad": offset})


@dataclass(frozen=True)
class Known:
    """A campaign: what is wrong, how it was measured, and which causes have to be named (those there are, if None)."""

    effects: tuple[Effect, ...]
    poses: int = 12
    loads: int = 1
    path: int = 0
    register: tuple[str, ...] = ()
    orientation: bool = False
    encoders: bool = False
    sigma: float = 2e-5
    named: tuple[str, ...] | None = None
    spoiled: tuple[int, ...] = ()
    wave: float = 0.0
    seed: int = 20


WAVES = {"cycles_per_turn": [1.0], "sine_rad": [3e-4], "cosine_rad": [2e-4]}
CAMPAIGNS: dict[str, Known] = {
    "nothing": Known(()),
    "a softer joint": Known((soft("joint_2", 4e-7),)),
    "a stiffer joint, noisier": Known((soft("joint_3", -2e-7),), sigma=6e-5),
    "a zero": Known((zero("joint_5", 6e-4),)),
    "a zero near the noise": Known((zero("joint_2", 2.5e-5),), poses=16),
    "play": Known((Effect("backlash", "joint_2", None, {"width_rad": 6e-4}),), poses=24),
    "play seen by encoders": Known((Effect("backlash", "joint_4", None, {"width_rad": 4e-4}),), encoders=True),
    "a gear": Known((Effect("transmission_error", "joint_1", None, WAVES),), poses=20, loads=0),
    "a length": Known((Effect("link_geometry", "joint_3", "tx", {"tx_m": 5e-4}),), poses=20, loads=0),
    "a link": Known((Effect("link_compliance", "joint_2", "rx", {"compliance_rad_per_Nm": 1e-6}),)),
    "the base plate": Known((Effect("base_compliance", None, "ry", {"compliance_rad_per_Nm": 2e-7}),)),
    "the tool": Known((Effect("tool_frame", None, None, {"tx_m": 4e-4, "ty_m": -3e-4, "tz_m": 0.0}),)),
    "base and tool unknown": Known((soft("joint_2", 4e-7),), register=("base", "tool")),
    "a scaled sensor": Known((Effect("wrench_scale", None, None, {"gain_error_ratio": 0.1}),), poses=16),
    "a payload": Known((Effect("payload", None, None, {"mass_kg": 15.0, "first_moment_kg_m": [1.0, 0.0, 2.0]}),)),
    "a jump": Known((Effect("frame_shift", None, None, {"row": 14, "tx_m": 5e-4, "ty_m": 0.0, "tz_m": -3e-4}),)),
    "counted backwards": Known((Effect("joint_coupling", "joint_4", None, {"reversed": True}),)),
    "a coupled wrist": Known((Effect("joint_coupling", "joint_5", None, {"other": "joint_4", "ratio": 8e-3}),)),
    "two causes and a typing error": Known((soft("joint_2", 4e-7), zero("joint_5", 6e-4)), spoiled=(5,)),
    "errors of no effect": Known((), poses=20, loads=0, wave=3e-4, named=()),
    "a cause beside errors of no effect": Known((soft("joint_2", 6e-7),), poses=14, wave=1e-4),
    "twelve rows": Known((zero("joint_3", 2e-3),), loads=0),
    "two zeros that are one length": Known(
        (zero("joint_2", 1e-4), zero("joint_3", -1e-4)), loads=0, named=("link_geometry",)
    ),
}


def draw(known: Known, robot: Robot) -> Campaign:
    """Measure a known campaign."""
    rows = plan_rows(robot, known.seed, poses=known.poses, loads=known.loads, path=known.path)
    if not known.path:
        rows = replace(rows, time=None)
    log = measure(
        robot, rows, known.effects, known.seed, orientation=known.orientation, encoders=known.encoders,
        sigma=known.sigma,
    )  # fmt: skip
    position = log.position.copy()
    position[list(known.spoiled)] += [0.02, 0.0, 0.0]
    q = log.q
    position += known.wave * np.sin(3.0 * q[:, [0, 1, 2]] + 2.0 * q[:, [2, 3, 4]] * q[:, [1, 0, 1]])
    return replace(log, position=position)


def diagnose_known(known: Known, robot: Robot) -> dict[str, Any]:
    """Diagnose a campaign; everything that is said of it, as plain values."""
    found = diagnose_campaign(robot, draw(known, robot), register=known.register)
    table = found.to_table()
    for one in table["delivered"]:
        one.pop("name", None)
    known_by = found.deliveries[0].uncertainty
    table["uncertainty"] = {
        "unexplained_mm": known_by.unexplained * 1e3, "scale": known_by.scale, "calibration": known_by.calibration,
        "rivals": [rival.weight for rival in known_by.rivals],
        "log_width": [float(np.log(d)) if d > 0 else 0.0 for u in known_by.unknowns[:8] for d in u.deviation],
    }  # fmt: skip
    table["candidates"] = table["candidates"][:3]
    return json.loads(json.dumps(table))


def differences(old: Any, new: Any, at: str = "") -> Iterator[str]:
    """Say where two answers differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key), new.get(key), f"{at}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from differences(before, after, f"{at}[{number}]")
    elif isinstance(old, float) and isinstance(new, float | int):
        if abs(old - new) > SHARE * abs(old) + LITTLE:
            yield f"{at}: {old:.6g} -> {new:.6g}"
    elif old != new:
        yield f"{at}: {old} -> {new}"


def make_robot() -> Robot:
    return write_small_robot(Path(mkdtemp()) / "small")


def list_numbers() -> list[tuple[str, str]]:
    """Module and name of every number at the head of a module of the diagnosis."""
    found = []
    for path in sorted(ROOM.rglob("*.py")):
        module = ".".join(path.relative_to(ROOM.parent.parent).with_suffix("").parts)
        for node in ast.parse(path.read_text()).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            if any(isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(node.value)):
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                found += [(module, n.id) for n in ast.walk(target) if isinstance(n, ast.Name)]
    return found


def scale(value: Any, factor: float) -> Any:
    """Multiply every number of a value; counts stay whole and above zero."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return max(round(value * factor), 1) if value else value
    if isinstance(value, float | np.ndarray):
        return value * factor
    if isinstance(value, tuple):
        return tuple(scale(entry, factor) for entry in value)
    if isinstance(value, dict):
        return {key: scale(entry, factor) for key, entry in value.items()}
    return value


@contextmanager
def moved(module: str, name: str, factor: float) -> Iterator[None]:
    """Multiply a number of the diagnosis wherever the package holds it, defaults of arguments included."""
    home = importlib.import_module(module)
    old = getattr(home, name)
    new = scale(old, factor)
    holders = [m for key, m in list(sys.modules.items()) if key.startswith("compplan") and vars(m).get(name) is old]
    functions = [f for f in vars(home).values() if callable(f) and getattr(f, "__module__", "") == module]
    defaults = [(f, f.__defaults__, f.__kwdefaults__) for f in functions if hasattr(f, "__defaults__")]
    for holder in holders:
        setattr(holder, name, new)
    for function, plain, named in defaults:
        if plain:
            function.__defaults__ = tuple(new if value is old else value for value in plain)
        if named:
            function.__kwdefaults__ = {key: new if value is old else value for key, value in named.items()}
    try:
        yield
    finally:
        for holder in holders:
            setattr(holder, name, old)
        for function, plain, named in defaults:
            function.__defaults__, function.__kwdefaults__ = plain, named


def find_witness(robot: Robot, truth: dict[str, Any]) -> str | None:
    """Name the first campaign whose answer is another one."""
    for name, known in CAMPAIGNS.items():
        try:
            if any(differences(truth[name], diagnose_known(known, robot))):
                return name
        except Exception as error:
            return f"{name}: {type(error).__name__}"
    return None


def study(numbers: Sequence[tuple[str, str]], factors: Sequence[float] = (2.0, 0.5)) -> None:
    """Say which of some numbers, at twice and at half their value, the campaigns see."""
    robot, truth, seen, count = make_robot(), json.loads(FILE.read_text()), 0, 0
    for module, name in numbers:
        for factor in factors:
            with moved(module, name, factor):
                witness = find_witness(robot, truth)
            seen, count = seen + (witness is not None), count + 1
            print(f"{module}.{name} times {factor:g}: {witness or 'not seen'}  ({seen} of {count})", flush=True)


if __name__ == "__main__":
    if "--study" in sys.argv:
        everything = list_numbers()
        order = np.random.default_rng(0).permutation(len(everything))
        study([everything[k] for k in order[: int(sys.argv[sys.argv.index("--study") + 1])]])
    else:
        own, answers = make_robot(), json.loads(FILE.read_text()) if sys.argv[1:] else {}
        answers |= {name: diagnose_known(CAMPAIGNS[name], own) for name in sys.argv[1:] or CAMPAIGNS}
        lines = [f"{json.dumps(name)}: {json.dumps(answer)}" for name, answer in answers.items()]
        FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
