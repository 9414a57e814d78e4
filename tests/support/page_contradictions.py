"""What one diagnosis says in its page, on the terminal and in diagnosis.json, and where these contradict each other."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.cli.commands.diagnose import describe_assessment, describe_diagnosis, describe_next
from compplan.diagnosis import Diagnosis
from compplan.diagnosis.evidence.unmodelled import names_alike
from compplan.diagnosis.results.accuracy import Assessment
from compplan.diagnosis.results.verdict import CLAIMED, FLOORS_LEFT
from compplan.diagnosis.results.where import Split
from compplan.reporting.diagnosis_page import write_diagnosis_page
from compplan.reporting.style import format_length

#: Words of a status on the first screen.
STATUSES = {
    "none": "Nothing is wrong", "unknown": "none of the known effects explains",
    "calibrated": "The robot was not calibrated", "explained": "Found", "partly_explained": "Found in part",
}  # fmt: skip
#: Words for an error that nothing takes up.
UNTAKEN = ("nothing explains", "none of them explains", "no effect explains it")
#: Shares of diagnosis.json have four decimals, those of a sentence three digits.
ROUNDING, SPOKEN = 2e-3, 0.5


@dataclass(frozen=True)
class Told:
    """What is said of one campaign.

    Attributes:
        table: What diagnosis.json holds.
        page: Text of the page.
        terminal: What the command prints.
        loaded: Whether any row has a load.
    """

    table: dict[str, Any]
    page: str
    terminal: str
    loaded: bool

    @property
    def text(self) -> str:
        """Return page and terminal."""
        return f"{self.page}\n{self.terminal}"


def read_page(file: Path) -> str:
    """Return the text of a page."""
    body = re.sub(r"<script.*?</script>|<style.*?</style>", " ", file.read_text(encoding="utf-8"), flags=re.S)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", body)))


def tell(found: Diagnosis, split: Split, assessment: Assessment, table: dict[str, Any], folder: Path) -> Told:
    """Write the page of a diagnosis and say everything else that is said of it."""
    write_diagnosis_page(found, folder / "report.html", split, assessment, table)
    campaign = found.fit.problem.campaign
    lines = [describe_diagnosis(found), describe_assessment(found, assessment), describe_next(found, folder)]
    loaded = bool(campaign.is_load(campaign.wrench[campaign.usable]).any())
    return Told(json.loads(json.dumps(table)), read_page(folder / "report.html"), "\n".join(lines), loaded)


def list_contradictions(told: Told) -> list[str]:
    """List everything in which page, terminal and diagnosis.json contradict themselves or each other."""
    return [f"{check.__name__}: {said}" for check in CHECKS for said in check(told)]


def place_of(entry: dict[str, Any]) -> tuple[str, str | None, str | None]:
    return entry["effect"], entry["joint"], entry["axis"]


def nameless_beside_its_effect(told: Told) -> Iterator[str]:
    """An error that no effect makes never stands beside the effect that makes it."""
    verdict = told.table["verdict"]
    for left in told.table["structure_left"]["depends_on"]:
        alike = [e for e in verdict["effects"] if names_alike(left["driver"], left["joint"], e["effect"], e["joint"])]
        for at in re.finditer(f"follows {re.escape(left['driver'])}", told.text) if alike else ():
            if "beyond the named" not in told.text[at.start() : at.start() + 200]:
                yield told.text[at.start() : at.start() + 80]
    if verdict["status"] in ("none", "calibrated", "explained") and "no named effect makes" in told.text.lower():
        yield f"{verdict['status']}, and an error is left"


def load_without_load(told: Told) -> Iterator[str]:
    """Where nothing was loaded, no share follows a load."""
    where = told.table["where"]
    kinds = (*where["by_factor"], *where.get("calibrated", {}).get("by_kind", {}))
    if not told.loaded and ("load" in kinds or re.search(r"By load\.|by load \(|\bload \d+ % \(95", told.page)):
        yield "a share of load"


def plan_with_nominal(told: Told) -> Iterator[str]:
    """Only a robot that predicts better is one to plan with."""
    nominal = told.table["delivered"][0]["kind"] == "nominal"
    if nominal is ("plan with it" in told.terminal):
        yield f"nominal: {nominal}, and the terminal says otherwise"
    if nominal and "Plan with the updated robot" in told.page:
        yield "plan with a nominal folder"


def more_than_the_gap(told: Told) -> Iterator[str]:
    """Shares add up to the gap at most, and named effects explain no more than there is."""
    where, gap = told.table["where"], told.table["gap"]["before_rms_mm"]
    inside = where.get("calibrated", {})
    divided = {"by_joint": where["by_joint"], "by_factor": where["by_factor"]}
    divided |= {f"calibrated {key}": inside[key] for key in ("by_joint", "by_kind") if key in inside}
    for key, shares in divided.items():
        total = sum(share["share"] for share in shares.values()) + where["noise_share"]
        if total > 1.0 + ROUNDING:
            yield f"{key}: {total:.4f}"
    sentence = (re.findall(r"Where: .*?\. Which:", told.page) or [""])[0]
    spoken = sum(map(float, re.findall(r"(?:carries|carry|explains|is) (?:above )?([\d.]+)\s%", sentence)))
    if spoken > 100.0 + SPOKEN:
        yield f"{spoken:.1f} % in {sentence}"
    for number, unit in re.findall(r"against ([\d.]+)\s(mm|µm) that the named effects explain", told.page):
        explained = float(number) * (1.0 if unit == "mm" else 1e-3)
        if explained > 1.02 * min(gap, sum(e["explained_rms_mm"] for e in told.table["verdict"]["effects"])):
            yield f"{number} {unit} explained of {gap} mm"


def other_status(told: Told) -> Iterator[str]:
    """Page, terminal and diagnosis.json have one status, and names where it says that there are some."""
    status, effects = told.table["verdict"]["status"], told.table["verdict"]["effects"]
    if f"verdict: {status.replace('_', ' ')}" not in told.terminal:
        yield "on the terminal"
    others = [words for key, words in STATUSES.items() if key not in (status, "explained")]
    if STATUSES[status] not in told.page or any(words in told.page for words in others):
        yield "on the page"
    if bool(effects) is not (status in ("explained", "partly_explained")):
        yield f"{status} with {len(effects)} names"
    if told.table["structure_left"]["present"] is not (status == "partly_explained") and effects:
        yield f"{status}, structure left: {told.table['structure_left']['present']}"


def other_probability(told: Told) -> Iterator[str]:
    """A name has one probability in every table and sentence, and one that is not named has none of a name."""
    verdict, named = told.table["verdict"], {place_of(e): e for e in told.table["verdict"]["effects"]}
    for entry in told.table["candidates"]:
        own = named.get(place_of(entry))
        if own is None and entry["probability"] >= CLAIMED:
            yield f"{place_of(entry)} is not named, candidate {entry['probability']}"
        if own is not None and abs(own["probability"] - entry["probability"]) > 1e-3:
            yield f"{place_of(entry)}: named {own['probability']}, candidate {entry['probability']}"
    for place, entry in named.items():
        said = f"probability {entry['probability']:.2f}"
        if entry["probability"] < CLAIMED or said not in told.terminal or said not in told.page:
            yield f"{place}: {said}"
        if any(place == place_of(other) for other in verdict["doubtful"] + verdict["minor"]):
            yield f"{place} is named and in doubt"
    if any(entry["probability"] >= CLAIMED for entry in verdict["doubtful"]):
        yield "in doubt, and more likely than not"


def named_beyond_a_bound(told: Told) -> Iterator[str]:
    """What no robot can have is not named."""
    yield from (e["beyond"] for e in told.table["verdict"]["effects"] if "beyond" in e)


def unexplained_beside_calibration(told: Told) -> Iterator[str]:
    """Nothing is said to be beyond all explanation that a delivered calibration takes up to the noise."""
    floor = told.table["gap"]["noise_floor_mm"]
    reached = told.table["delivered"][0]["kind"] == "calibrated"
    reached = reached and told.table["delivered"][0]["held_out_rms_mm"] <= FLOORS_LEFT * floor
    untaken = UNTAKEN if told.table["verdict"]["status"] == "calibrated" else (*UNTAKEN, "no model explains")
    for words in untaken if reached else ():
        if words in told.text:
            yield words
    if "calibration takes it up to the noise" in told.page and not reached:
        yield "no calibration reaches the noise"


def noise_that_no_model_explains(told: Told) -> Iterator[str]:
    """Where nothing is wrong, nothing is left that a model would have to explain."""
    if told.table["verdict"]["status"] == "none" and "no model explains" in told.page:
        yield "nothing is wrong, and no model explains a part of it"


def poses_that_are_not_listed(told: Told) -> Iterator[str]:
    """A page that sends its reader to poses below has some."""
    if "as listed below" in told.page and not any(step.get("poses") for step in told.table["next_measurement"]):
        yield "no pose is listed"


def other_figures(told: Told) -> Iterator[str]:
    """The error of the updated robot is the one of the folder that is delivered, on the page and on the terminal."""
    gap, first = told.table["gap"], told.table["delivered"][0]
    if abs(gap["held_out_after_rms_mm"] - first["held_out_rms_mm"]) > 2e-5:
        yield f"{gap['held_out_after_rms_mm']} mm, folder {first['held_out_rms_mm']} mm"
    for key in ("held_out_after_rms_mm", "noise_floor_mm"):
        shown = format_length(1e-3 * gap[key]).replace("\u00a0", " ")
        if shown not in told.page.replace("\u00a0", " ") or f"{gap[key]:.3f} mm" not in told.terminal:
            yield f"{key}: {shown}"
    if gap["held_out_after_rms_mm"] > gap["held_out_before_rms_mm"] and first["kind"] != "nominal":
        yield "the updated robot predicts worse"


CHECKS = (
    nameless_beside_its_effect, load_without_load, plan_with_nominal, more_than_the_gap, other_status,
    other_probability, named_beyond_a_bound, unexplained_beside_calibration, noise_that_no_model_explains,
    poses_that_are_not_listed, other_figures,
)  # fmt: skip
