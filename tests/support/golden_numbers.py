"""Every number of tables and summaries that commands write, folded place by place.

`python tests/support/golden_numbers.py` writes them anew.

A number that changes is not wrong for that: whoever means the change looks at it, and writes the file anew. Who does
not mean it has mixed up a unit, a sign or a place.
"""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from benchmarks.bad_inputs.running import load_commands

HERE = Path(__file__).parents[1]
GOOD = HERE / "bad_inputs" / "good"
GOLDEN = HERE / "golden_numbers.json"
EXAMPLES = HERE.parent / "examples"
COMMANDS = {
    "plan": "plan job.toml --out out",
    "plan a cut": "plan mill.toml --out out",
    "forces and a log": "forces mill.toml --log cutting.csv --out out",
    "forces of holes": f"forces {EXAMPLES / 'forces' / 'plate.toml'} --out out",
    "forces of forming": f"forces {EXAMPLES / 'forces' / 'isf_cone.toml'} --out out",
    "map": "map robot --points 5 --azimuth-deg 30 --out out",
    "identify": "identify log.csv --robot robot --register base,tool --out out",
    "diagnose": "diagnose log.csv --robot robot --out out",
    "predict": "predict log.csv --robot robot --out out/predicted.csv",
    "campaign": "campaign job.toml --poses 4 --out out",
    "learn": "learn job.toml measured.csv --robot robot --align datum --out out",
    "place": "place job.toml --out out",
    "compare": "compare job.toml --out out",
    "montecarlo": "montecarlo mill.toml --samples 16 --replicates 2 --workers 2 --no-sensitivity"
    " --strategies none,mirror,nlp,secondary_encoder --out out",
    "convert": "convert part.gcode --out out/part.csv --report out",
    "post": "post part.apt --robot robot --part 1700,0,900 --program krl --feed 20 --out out",
    "doctor": "doctor robot --json",
}  # fmt: skip
#: Words of keys under which no number of the subject stands.
IDLE = (
    "solve_time", "map_time", "took", "elapsed", "cpu", "seconds", "version", "fingerprint", "sha", "manifest",
    "made_with", "made_by", "origin", "duration", "evaluations",
)  # fmt: skip
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?(?![\w])")
DATE = re.compile(r"\d{4}-\d\d-\d\d")
Folded = dict[str, list[float]]


def run_command_line(words: str, folder: Path) -> tuple[Path, str]:
    """Run a command in a copy of the good inputs. Returns the folder that it wrote and what it printed."""
    shutil.copytree(GOOD, folder, dirs_exist_ok=True)
    (folder / "out").mkdir(exist_ok=True)
    before = Path.cwd()
    os.chdir(folder)
    try:
        load_commands()
        from compplan.cli import group

        answer = CliRunner().invoke(group, words.split(), catch_exceptions=False)
    finally:
        os.chdir(before)
    assert answer.exit_code in (0, 3), answer.output
    return folder / "out", answer.stdout


def fold_outputs(out: Path, printed: str) -> Folded:
    """Fold the numbers of tables and summaries: of each place their count, sum of sizes, and sum by order."""
    numbers: dict[str, list[float]] = defaultdict(list)
    for file in sorted(out.rglob("*")):
        name = str(file.relative_to(out))
        if name == "manifest.json" or "samples" in name:
            continue
        if file.suffix == ".json":
            _gather(json.loads(file.read_text(encoding="utf-8")), name, numbers)
        elif file.suffix == ".csv":
            with file.open(encoding="utf-8") as rows:
                for row in csv.DictReader(line for line in rows if not line.startswith("#")):
                    _gather(row, name, numbers)
    told = re.sub(r"\d+(?:\.\d+)? ?s\b", "", printed)  # times that anything took
    _gather(told, "printed", numbers)
    return {place: _fold(values) for place, values in sorted(numbers.items())}


def _gather(value: Any, place: str, into: dict[str, list[float]]) -> None:
    if isinstance(value, dict):
        for key, one in value.items():
            if not any(idle in str(key) for idle in IDLE):
                _gather(one, f"{place}/{key}", into)
    elif isinstance(value, list):
        for one in value:
            _gather(one, place, into)
    elif isinstance(value, str):
        into[place] += [float(text) for text in NUMBER.findall(DATE.sub("", value))][:200]
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        into[place].append(float(value))


def _fold(values: list[float]) -> list[float]:
    by_order = sum(value * (1 + k % 7) for k, value in enumerate(values))
    return [len(values), float(f"{sum(map(abs, values)):.6g}"), float(f"{by_order:.6g}")]


def differences(found: Folded, golden: Folded) -> Iterator[str]:
    """Say which places differ: another count, or sums that differ by more than 1 % of the sum of sizes."""
    for place in sorted(found.keys() | golden.keys()):
        one, other = found.get(place), golden.get(place)
        if one is None or other is None:
            yield f"{place}: {'gone' if one is None else 'new'}"
        elif one[0] != other[0] or any(abs(a - b) > 0.01 * other[1] + 1e-9 for a, b in zip(one, other, strict=True)):
            yield f"{place}: {other} before, {one} now"


def main() -> None:
    golden = {}
    for name, words in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            golden[name] = fold_outputs(*run_command_line(words, Path(folder)))
        print(name, len(golden[name]), flush=True)
    lines = [f"{json.dumps(name)}: {{\n" + ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in g.items()) + "\n}"
             for name, g in golden.items()]  # fmt: skip
    GOLDEN.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
