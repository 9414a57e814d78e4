"""One page about the diagnosis: own suites beside a plain rival and FIGAROH, labelled campaigns, and a real robot.

    python -m benchmarks.diagnosis_report --suites DIR.. --labelled DIR --real DIR --out OUT

Answers are kept one JSON a case in OUT, so that an interrupted run goes on. OUT/results.json, kept from an earlier
commit, is the `--before` of a later run. FIGAROH needs an interpreter that has it (extra "peers"): --figaroh-python;
without one every table says that it was not run, and why.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.answer_scores import CONFIDENT, Score, summarise
from benchmarks.contestants import miss_figaroh, read_truth, write_whole
from benchmarks.diagnosis_score import answer_all, list_cases, name_of, score_all, write_table
from benchmarks.diagnosis_sections import (
    compare_classes,
    compare_predictions,
    judge_probabilities,
    list_answers,
    list_wrong,
    show_real,
    show_share,
    word_of,
)
from benchmarks.real_campaign import cut_campaign, other_part, repeat_claims
from compplan.reporting.page import Provenance, Section, write_page

Table = dict[str, Any]
#: What the page assumes.
ASSUMED = (
    "Sizes, noise, designs, backgrounds and unknown causes of the drawn campaigns are assumed.",
    "A small background error may be named where its own gap is one standard deviation of a coordinate or more.",
    "Acceptable rivals of a truth are those that its drawing lists; a tie is one within two standard deviations.",
    "The plain rival's odds against the size of an effect were fitted on 77 drawn campaigns.",
    "FIGAROH is given positions from which the nominal robot's own bending under the load is taken off.",
)


class Study:
    """Everybody's answers to folders of cases, kept in one folder."""

    def __init__(self, tree: Path, out: Path, figaroh: Path | None, workers: int) -> None:
        self.tree, self.out, self.workers = tree, out, workers
        self.names = ["product", "rival", "geometry"]
        self.missed = miss_figaroh(figaroh)
        if not self.missed:
            self.names.insert(2, f"figaroh={figaroh}")

    def ask(self, cases: Sequence[Path]) -> dict[str, dict[str, Table]]:
        """Return the answers of every contestant to every case."""
        found = {n: answer_all(cases, n, self.tree, self.out / "answers", self.workers) for n in self.names}
        return {name.split("=")[0]: answers for name, answers in found.items()}

    def score(self, cases: Sequence[Path]) -> dict[str, list[Score]]:
        """Return the scores of every contestant."""
        return {name: score_all(cases, answers) for name, answers in self.ask(cases).items()}


def commit_of(tree: Path) -> str:
    """Return the commit of a source tree, or "not known"."""
    words = ["git", "-C", str(tree), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "not known"


def study_suites(study: Study, suites: Sequence[Path], before: Table, results: Table) -> list[Section]:
    """Score every suite and all together."""
    sections: list[Section] = []
    every: dict[str, list[Score]] = {}
    for suite in suites:
        cases = list_cases([suite])
        scores = study.score(cases)
        for name, part in scores.items():
            every.setdefault(name, []).extend(part)
        summaries = {name: summarise(part) for name, part in scores.items()}
        results["suites"][suite.name] = summaries
        shown = {**_before(before, suite.name), **summaries}
        sections.append(compare_classes(f"Suite {suite.name.replace('_', ' ')}", shown, len(cases)))
    if every:
        summaries = {name: summarise(every[name]) for name in ("product", "rival")}
        sections += [judge_probabilities(summaries), compare_predictions(every), list_wrong(every)]
    return sections


def _before(before: Table, suite: str) -> dict[str, Table]:
    summaries = before.get("suites", {}).get(suite)
    return {"before": summaries["product"]} if summaries else {}


def study_real(study: Study, real: Path, results: Table, wanted: tuple[str, ...] = ("",)) -> Section:
    """Answer a real campaign whole, mirrored, in halves and thinned: the parts whose names begin as wanted."""
    suite = study.out / f"real_{real.name}"
    parts = [part for part in cut_campaign(real, suite) if part.startswith(wanted)]
    cases = [suite / part for part in parts]
    answers = study.ask(cases)
    table = {
        part: {name: score_all([case], {name_of(case): said[name_of(case)]})[0] for name, said in answers.items()}
        for part, case in zip(parts, cases, strict=True)
    }
    pairs = [(part, other_part(part)) for part in parts if other_part(part) is not None and part.endswith("a")]
    claims = {
        name: [[answers[name][name_of(suite / str(part))]["verdict"]["effects"] for part in pair] for pair in pairs]
        for name in ("product", "rival")
    }
    repeats = {name: count_repeats(told, CONFIDENT) for name, told in claims.items()}
    results.setdefault("reals", {})[real.name] = results["real"] = {
        part: {
            name: {"status": s.status, "stated_mm": _finite(s.stated), "true_mm": _finite(s.fresh)}
            for name, s in row.items()
        }
        for part, row in table.items()
    }
    results["repeat_in_pairs"] = {name: {"hits": h, "claims": n} for name, (h, n) in repeats.items()}
    for least in (0.5, CONFIDENT):
        hits, count = count_repeats(claims["product"], least)
        click.echo(f"{real.name}: {hits} of {count} claims stated {least:g} and more repeat without a common pose")
    click.echo(print_real(real.name, table))
    return show_real(table, repeats, real.name.replace("_", " "))


def count_repeats(pairs: Sequence[list[list[Table]]], least: float) -> tuple[int, int]:
    """Count the claims of pairs of parts that the other part tells as well, and all of them."""
    counts = [repeat_claims(pair, least) for pair in pairs]
    return sum(hits for hits, _ in counts), sum(count for _, count in counts)


def print_real(name: str, table: dict[str, dict[str, Score]]) -> str:
    """Return true errors part by part, what the product states, and its status, as text. [mm]"""
    contestants = list(next(iter(table.values())))
    lines = [f"{name:16s}" + "".join(f"{c:>10s}" for c in ("nominal", *contestants, "stated")) + "  status"]
    for part, scores in table.items():
        first = scores["product"]
        errors = (first.nominal, *(scores[c].fresh for c in contestants), first.stated)
        lines.append(f"{part:16s}" + "".join(f"{value:10.3f}" for value in errors) + f"  {first.status}")
    return "\n".join(lines)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def describe_real(results: Table) -> list[str]:
    """Say what a real campaign shows: error on rows given to nobody, and how far the stated one is off."""
    parts: Table = results.get("real", {})
    if not parts:
        return []
    first = "whole" if "whole" in parts else next(iter(parts))
    whole = [f"{word_of(name)} {row['true_mm']:.3g}" for name, row in parts[first].items() if row["true_mm"]]
    rows = {part: row["product"] for part, row in parts.items() if row["product"]["true_mm"]}
    ratios = {part: row["stated_mm"] / row["true_mm"] for part, row in rows.items() if row["stated_mm"]}
    if not ratios:
        return []
    least = min(ratios, key=lambda part: ratios[part])
    off = float(np.median([abs(ratio - 1.0) for ratio in ratios.values()]))
    return [
        f"A real robot, rms of rows given to nobody, {first.replace('_', ' ')} campaign: {', '.join(whole)} mm.",
        f"What the diagnosis states of itself is off by {100 * off:.0f} % in the median of {len(ratios)} parts, and "
        f"{ratios[least]:.2f} of the true error at the least ({least.replace('_', ' ')}).",
    ]


def describe_lede(results: Table) -> list[str]:
    """Say the answer in a few sentences."""
    out = []
    for suite, summaries in results["suites"].items():
        product, rival = (summaries[n]["shares"] for n in ("product", "rival"))
        singles, sure = "singles placed", "wrong among claims stated .8 and more"
        out.append(
            f"{suite.replace('_', ' ')}: single effects are named at their place in {show_share(product[singles])} "
            f"campaigns (plain rival {show_share(rival[singles])}); claims stated .8 and more are wrong in "
            f"{show_share(product[sure])} (rival {show_share(rival[sure])})."
        )
    return [*out, *describe_real(results)]


@click.command()
@click.option(
    "--suites", multiple=True, type=click.Path(path_type=Path, exists=True), help="Folder of drawn campaigns."
)
@click.option("--labelled", type=click.Path(path_type=Path, exists=True), help="Folder of campaigns shown singly.")
@click.option(
    "--real", multiple=True, type=click.Path(path_type=Path, exists=True), help="Folder of a real campaign."
)
@click.option("--parts", multiple=True, help="Parts of real campaigns by how their names begin; all if left out.")
@click.option("--product-tree", type=click.Path(path_type=Path, exists=True), default=Path(), show_default=True)
@click.option("--figaroh-python", type=click.Path(path_type=Path, exists=True), help="Interpreter that has FIGAROH.")
@click.option("--before", type=click.Path(path_type=Path, exists=True), help="results.json of an earlier run.")
@click.option("--workers", type=click.IntRange(1, 2), default=2, show_default=True, help="Processes.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
def main(
    suites: tuple[Path, ...], labelled: Path | None, real: tuple[Path, ...], parts: tuple[str, ...], product_tree: Path,
    figaroh_python: Path | None, before: Path | None, workers: int, out: Path,
) -> None:  # fmt: skip
    """Make the page of the diagnosis beside its rivals."""
    out, tree = out.resolve(), product_tree.resolve()
    study = Study(tree, out, figaroh_python.absolute() if figaroh_python else None, workers)
    earlier = {} if before is None else json.loads(before.read_text(encoding="utf-8"))
    not_run = f"not run: {study.missed}" if study.missed else ""
    results: Table = {"commit": commit_of(tree), "figaroh": not_run or "run", "suites": {}}
    sections = study_suites(study, [s.resolve() for s in suites], earlier, results)
    if labelled is not None:
        cases = list_cases([labelled.resolve()])
        scores = study.score(cases)
        results["labelled"] = {name: summarise(part) for name, part in scores.items()}
        truths = [read_truth(case) for case in cases]
        sections.append(list_answers("Labelled campaigns, one by one", truths, scores))
    for folder in real:
        sections.append(study_real(study, folder.resolve(), results, parts or ("",)))
    for name, summaries in results["suites"].items():
        click.echo(f"\n{name}\n{write_table(summaries)}")
    if not_run:
        click.echo(f"FIGAROH: {not_run}")
    facts = [("product", f"commit {results['commit']}"), ("suites", ", ".join(s.name for s in suites) or "none")]
    facts.append(("FIGAROH", results["figaroh"]))
    if earlier:
        facts.append(("before", f"commit {earlier.get('commit', 'not known')}"))
    write_whole(out / "results.json", json.dumps(results, indent=1) + "\n")
    write_page(
        out / "report.html", "The diagnosis on robots that it has never met",
        describe_lede(results) or "Labelled campaigns.", sections,
        kind="Benchmark of the diagnosis", provenance=Provenance(facts, ASSUMED),
    )  # fmt: skip
    click.echo(str(out / "report.html"))


if __name__ == "__main__":
    main()
