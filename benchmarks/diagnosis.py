"""Ask the product and the plain rival about the same labelled campaigns and score both side by side.

    python -m benchmarks diagnosis SUITE.. --product-tree . --out OUT

A suite is a folder of cases (robot/, measurements.csv, fresh.csv, truth.json). Every answer is kept in OUT/NAME, one
JSON a case, so that an interrupted run goes on where it stopped; OUT/scores.json and OUT/scores.md hold the table.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click

from benchmarks.answer_scores import Score, score_answer, summarise
from benchmarks.contestants import (
    ask_calibration,
    ask_figaroh,
    ask_product,
    ask_rival,
    frames_of,
    miss_figaroh,
    read_truth,
    refused,
    write_whole,
)

Table = dict[str, Any]
#: Contestants that are not the product: asked in this process.
PLAIN = {"rival": ask_rival, "geometry": ask_calibration}
#: Contestants that name no effect, and the classes that they are scored in.
NAMELESS, PREDICTED = ("figaroh", "geometry"), ("later campaign", "no answer")


def list_cases(suites: Sequence[Path]) -> list[Path]:
    """Return the folders of all cases, in order of their names."""
    return [file.parent for suite in suites for file in sorted(suite.glob("*/truth.json"))]


def name_of(case: Path) -> str:
    """Return a name of a case that no other suite uses."""
    return f"{case.parent.name}__{case.name}"


def answer_case(case: Path, contestant: str, tree: Path) -> Table:
    """Let one contestant answer one case: a name of PLAIN, figaroh=PYTHON, or any other name for the product."""
    register = frames_of(read_truth(case))
    if contestant.startswith("figaroh="):
        return ask_figaroh(case, Path(contestant.removeprefix("figaroh=")), register)
    plain = PLAIN.get(contestant)
    if plain is None:
        return ask_product(case, tree, register)
    try:
        return plain(case, register)
    except Exception as error:  # a rival that breaks has given no answer, the study goes on
        return refused(f"{type(error).__name__}: {error}")


def answer_all(cases: Sequence[Path], contestant: str, tree: Path, out: Path, workers: int) -> dict[str, Table]:
    """Answer every case; those that OUT/CONTESTANT holds already are read."""
    files = {case: out / contestant.split("=")[0] / f"{name_of(case)}.json" for case in cases}
    missing = [case for case in cases if not _answered(files[case])]
    label, stderr = contestant.split("=")[0], click.get_text_stream("stderr")
    with click.progressbar(range(len(missing)), label=label, file=stderr) as progress:
        for case, answer in _run(missing, contestant, tree, workers):
            write_whole(files[case], json.dumps(answer) + "\n")
            progress.update(1)
    return {name_of(case): json.loads(files[case].read_text(encoding="utf-8")) for case in cases}


def _answered(file: Path) -> bool:
    """Tell whether a case has its answer; one that was refused is asked again."""
    return file.is_file() and json.loads(file.read_text(encoding="utf-8"))["verdict"]["status"] != "refused"


def _run(cases: Sequence[Path], contestant: str, tree: Path, workers: int) -> Iterator[tuple[Path, Table]]:
    if workers < 2:
        yield from ((case, answer_case(case, contestant, tree)) for case in cases)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(answer_case, case, contestant, tree): case for case in cases}
        for job in as_completed(jobs):
            yield jobs[job], job.result()


def score_all(cases: Sequence[Path], answers: dict[str, Table]) -> list[Score]:
    """Score the answers of one contestant."""
    return [score_answer(name_of(case), read_truth(case), answers[name_of(case)]) for case in cases]


def write_table(summaries: dict[str, Table]) -> str:
    """Write the contestants side by side as a table in Markdown."""
    names = list(summaries)
    lines = ["| class | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for key in summaries[names[0]]["shares"]:
        told = [n not in NAMELESS or key.startswith(PREDICTED) for n in names]
        cells = [_cell(summaries[n]["shares"][key]) if t else "-" for n, t in zip(names, told, strict=True)]
        lines.append(f"| {key} | " + " | ".join(cells) + " |")
    for key, value in summaries[names[0]].items():
        if value is None or isinstance(value, float):
            blind = NAMELESS if key.startswith("false_names") else ()
            numbers = [None if n in blind else summaries[n][key] for n in names]
            lines.append(f"| {key} | " + " | ".join("-" if v is None else f"{v:.3g}" for v in numbers) + " |")
    return "\n".join(lines) + "\n"


def _cell(part: Table) -> str:
    if not part["count"]:
        return "-"
    low, mid, high = (round(100 * part[key]) for key in ("low", "share", "high"))
    return f"{part['hits']}/{part['count']} = {mid} % ({low}-{high})"


def describe_cases(scores: dict[str, list[Score]]) -> str:
    """List what each contestant said, case by case."""
    lines = []
    for rows in zip(*scores.values(), strict=True):
        lines.append(f"{rows[0].case} ({rows[0].kind})")
        for contestant, s in zip(scores, rows, strict=True):
            said = ", ".join(f"{c.label} {c.probability:.2f}{'' if c.right else ' WRONG'}" for c in s.claims) or "-"
            missed = f"; missed: {', '.join(s.missed)}" if s.missed else ""
            error = f"stated {s.stated:.3f} true {s.fresh:.3f} nominal {s.nominal:.3f} floor {s.floor:.3f} mm"
            lines.append(f"    {contestant}: {s.status}: {said}{missed}; {error}")
    return "\n".join(lines) + "\n"


@click.command()
@click.argument("suites", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--product-tree", type=click.Path(path_type=Path, exists=True), default=Path(), show_default=True,
              help="Source tree whose compplan is asked.")  # fmt: skip
@click.option("--name", default="product", show_default=True, help="Name of the product's answers in OUT.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--workers", type=click.IntRange(1, 2), default=2, show_default=True, help="Processes.")
@click.option("--rival/--no-rival", default=True, show_default=True, help="Ask the plain rival as well.")
@click.option("--geometry", is_flag=True, help="Ask a plain calibration of geometry and compliances as well.")
@click.option("--figaroh-python", type=click.Path(path_type=Path, exists=True), help="Interpreter that has FIGAROH.")
def main(
    suites: tuple[Path, ...], product_tree: Path, name: str, out: Path, workers: int, rival: bool, geometry: bool,
    figaroh_python: Path | None,
) -> None:  # fmt: skip
    """Score the product beside the plain rival on labelled campaigns."""
    cases = list_cases([suite.resolve() for suite in suites])
    scores: dict[str, list[Score]] = {}
    summaries: dict[str, Table] = {}
    asked = ["rival"] * rival + ["geometry"] * geometry
    if figaroh_python is not None:
        if missed := miss_figaroh(figaroh_python):
            raise click.UsageError(f"FIGAROH cannot be asked: {missed}")
        asked.append(f"figaroh={figaroh_python.absolute()}")
    for contestant in [*asked, name]:
        answers = answer_all(cases, contestant, product_tree.resolve(), out.resolve(), workers)
        short = contestant.split("=")[0]
        scores[short] = score_all(cases, answers)
        summaries[short] = summarise(scores[short])
    write_whole(out / "scores.json", json.dumps(summaries, indent=1) + "\n")
    text = write_table(dict(reversed(summaries.items())))
    write_whole(out / "scores.md", text + "\n" + describe_cases(scores))
    click.echo(text)


if __name__ == "__main__":
    main()
