"""A campaign of every effect on two robots, drawn in MuJoCo, with its truth and the answer of the diagnosis.

    python -m benchmarks.every_effect [--robot turned] [--effect backlash] [--out table.md]

The cases are those of tests/effect_cases.py, one a robot and effect, measured with 10 um a axis; nothing is left out of
the candidates. A row says what was put in, what is named with which probability, and whether the truth is among them or
stands as ambiguous with one of them.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

from compplan.diagnosis import diagnose_campaign
from compplan.diagnosis.answer.result import Diagnosis
from compplan.effects import Effect
from tests.drawn_campaigns import draw_robot_files
from tests.effect_cases import CASES, ROBOTS, Place

NOISE = 1e-5
TITLES = ("robot", "put in", "size", "status", "named", "truth named", "rms before, after, held out (mm)")


def choose_cases(robot: str | None, effect: str | None) -> list[Place]:
    """Choose one case a robot and effect: the one that tests fit, if there is one."""
    chosen: dict[tuple[str, str], Place] = {}
    for place, case in CASES.items():
        wanted = (robot or place[0], effect or place[1]) == place[:2]
        if wanted and (case.fit or place[:2] not in chosen):
            chosen[place[:2]] = place
    return sorted(chosen.values(), key=lambda place: (place[1], place[0]))


def diagnose_case(place: Place) -> Diagnosis:
    """Draw the campaign of a case and diagnose it."""
    case = CASES[place]
    with tempfile.TemporaryDirectory() as folder:
        drawn = draw_robot_files(case.base or ROBOTS[place[0]], Path(folder))
        campaign, _ = drawn.measure(case.real(drawn.nominal), noise=NOISE)
        return diagnose_campaign(drawn.robot, campaign)


def describe_place(effect: Effect) -> str:
    """Return effect, joint and axis in a few letters."""
    return " ".join(str(part) for part in effect.place if part)


def describe_sizes(effect: Effect) -> str:
    """Return the first two numbers of an effect with their keys."""
    numbers = [(k, v) for k, v in effect.parameters.items() if isinstance(v, float)]
    lists = [(k, v[0]) for k, v in effect.parameters.items() if isinstance(v, list) and isinstance(v[0], float)]
    return ", ".join(f"{key} {value:.3g}" for key, value in (numbers + lists)[:2]) or "as counted"


def describe_case(place: Place) -> str:
    """Return the row of a case."""
    truth, found = CASES[place].effect, diagnose_case(place)
    verdict, gap = found.verdict, found.gap
    named = [f"{describe_place(f.effect)} {f.probability:.2f} ({describe_sizes(f.effect)})" for f in verdict.findings]
    places = {f.effect.place for f in verdict.findings}
    alike = {r.place for f in verdict.findings for r in f.rivals if r.alike}
    right = "yes" if truth.place in places else "ambiguous" if truth.place in alike else "no"
    rms = ", ".join(f"{1e3 * value:.3f}" for value in (gap.before, gap.after, gap.held_out_after))
    found = "; ".join(named) or "nothing"
    cells = (place[0], describe_place(truth), describe_sizes(truth), verdict.status, found, right, rms)
    return f"| {' | '.join(cells)} |"


def table_rows(places: list[Place]) -> Iterator[str]:
    """Yield the table, row by row."""
    yield f"| {' | '.join(TITLES)} |\n{'|---' * len(TITLES)}|"
    for place in places:
        yield describe_case(place)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=ROBOTS)
    parser.add_argument("--effect", choices=sorted({place[1] for place in CASES}))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for row in table_rows(choose_cases(options.robot, options.effect)):
        rows.append(row)
        print(row, flush=True)
    if options.out:
        options.out.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
