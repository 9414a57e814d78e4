"""The diagnosis beside a plain rival on drawn campaigns that it has not met."""

from __future__ import annotations

import json

from benchmarks.diagnosis import write_table
from benchmarks.results.chart import Chart
from benchmarks.results.findings import ROOT, Findings, Settings, run_benchmark

TITLE = "Diagnosis: does it name the hidden effect?"
QUESTION = "On drawn campaigns whose effects are withheld: how often is the right effect named at its place?"
METHOD = (
    "`benchmarks.outsider` draws campaigns from the published file formats alone; its author had read neither "
    "compplan nor the other generator. `benchmarks.diagnosis` runs compplan by its command line, a plain "
    "rival (least squares with the whole vocabulary, greedy, with BIC), a plain calibration (geometry: all lengths, "
    "zeros and compliances) and FIGAROH's geometric calibration, which name no effect. Shares have 95 % Wilson "
    "intervals."
)
CHART = Chart("share of campaigns, %", {"compplan": ("compplan", 2), "plain rival": ("rival", 2)}, rows=8)
LIMITS = (
    "Drawn robots. For measured robots see [diagnosis_real](diagnosis_real.md).",
    "Generator and vocabulary share the list of effects of the file format.",
    "Few campaigns: the intervals are wide. None was used in development.",
    "FIGAROH fits geometry to 400 rows at rest at most, less the nominal springs' deflection; it has no compliances.",
)
#: Campaigns that no rule or number of the diagnosis was developed on.
SEEDS = "11210:11250"
#: Rows of the page, and what they are called.
ROWS = {
    "singles placed": "single effects named at their place", "doubles complete": "pairs named completely",
    "effects of triples and quadruples placed": "effects of triples and quadruples named",
    "known beside unknown placed": "known effects beside an unknown named",
    "unknown called so": "unknown called unknown",
    "unknown: nothing false": "unknown: no false name",
    "nothing there or everyday errors: no false name": "nothing wrong: nothing named",
    "precision of claims": "claims that are right", "ties honest": "inseparable causes listed as such",
    "wrong among claims stated .8 and more": "wrong among claims of .8 and more",
    "later campaign predicted worse than by the nominal robot": "later campaign predicted worse than nominal",
    "stated error below .8 of the true one": "stated error below .8 of the true one",
    "stated_over_true_median": "stated over true error, median",
    "fresh_over_floor_median": "error of a later campaign over noise floor, median",
    "seconds_median": "CPU, median, s",
}  # fmt: skip
#: What the contestants are called on the page.
WORDS = {"product": "compplan", "rival": "plain rival", "geometry": "plain calibration", "figaroh": "FIGAROH"}
SINGLES, DOUBLES = "singles placed", "doubles complete"
NOTHING, SURE = "nothing there or everyday errors: no false name", "wrong among claims stated .8 and more"


def measure(settings: Settings) -> Findings:
    """Draw, ask and score."""
    run_benchmark("benchmarks.outsider", "--seeds", SEEDS, "--out", settings.work / "suite")
    peer = ["--figaroh-python", settings.figaroh] if settings.figaroh else []
    run_benchmark("benchmarks.diagnosis", settings.work / "suite", "--product-tree", ROOT, "--geometry", *peer,
                  "--out", settings.work / "scores")  # fmt: skip
    scores = json.loads((settings.work / "scores" / "scores.json").read_text("utf-8"))
    table = write_table({"compplan" if name == "product" else name: found for name, found in scores.items()}).strip()
    lines = [line.split(" | ", 1) for line in table.splitlines()]
    named = [f"| {ROWS[name[2:]]} | {cells}" for name, cells in lines[2:] if name[2:] in ROWS]
    table = "\n".join([*table.splitlines()[:2], *named])
    ours, rival = scores["product"]["shares"], scores["rival"]["shares"]

    def beside(key: str) -> str:
        return f"{_hits(ours[key])} (plain rival {_hits(rival[key])})"

    worse = [
        f"{key}: {_hits(ours[key])}, the plain rival {_hits(rival[key])}."
        for key in ours if ours[key]["count"] and rival[key]["count"] and _loses(key, ours[key], rival[key])
    ]  # fmt: skip
    if settings.figaroh is None:
        worse.append("FIGAROH was not run: no --figaroh-python.")
    return Findings(
        (
            f"Single effects are named at their place in {beside(SINGLES)}.",
            f"Pairs of effects are named completely in {beside(DOUBLES)}.",
            f"Without a hidden effect, none is named in {beside(NOTHING)}.",
            f"Names stated with a probability of .8 or more are wrong in {beside(SURE)}.",
            "Error of a later campaign over its noise floor, median: "
            + ", ".join(f"{WORDS[name]} {found['fresh_over_floor_median']:.2f}" for name, found in scores.items())
            + f", nominal robot {scores['product']['nominal_over_floor_median']:.2f}.",
        ),
        (table,),
        tuple(worse),
    )


def _hits(share: dict) -> str:
    return f"{share['hits']} of {share['count']}"


def _loses(key: str, ours: dict, rival: dict) -> bool:
    bad = any(word in key for word in ("wrong", "worse", "no answer", "below"))
    return ours["share"] > rival["share"] if bad else ours["share"] < rival["share"]
