"""The page and the files of a study of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from compplan.files.origin import describe_origin
from compplan.files.tables import write_json, write_text
from compplan.files.transaction import replace_folder
from compplan.report.page import Block, Chart, Column, Columns, PageTable, Provenance, Section, TableCell, write_page
from compplan.report.style import format_number

Row = list[TableCell | str | float | int | None]


def write_study(
    summary: Mapping[str, Any], failures: Sequence[str], out: Path, facts: Sequence[tuple[str, str]], title: str
) -> None:
    """Write selftest.json, report.html and failures.txt.

    Args:
        summary: What `summarise_study` returned.
        failures: What `list_failures` returned.
        out: Folder.
        facts: Rows of name and value: seed, source of the campaigns, date.
        title: Title of the page.
    """
    table = {**summary, "facts": dict(facts), "made_by": describe_origin()}
    with replace_folder(out, "selftest-diagnosis") as part:
        write_json(part / "selftest.json", table, indent=2)
        write_text(part / "failures.txt", "".join(f"{line}\n" for line in failures))
        _write_page(summary, failures, part / "report.html", facts, title)


def _write_page(
    summary: Mapping[str, Any], failures: Sequence[str], file: Path, facts: Sequence[tuple[str, str]], title: str
) -> None:
    sections = [_rates(summary), _calibration(summary), _confusion(summary), _detection(summary), _withheld(summary)]
    shown: list[Row] = [[part.strip() for part in line.split("|")] for line in failures]
    heads = [Column("failure"), Column("case"), Column("there"), Column("said"), Column("later campaign")]
    if shown:
        sections.append(Section("Wrong answers", [PageTable(heads, shown, "Every wrong answer.", 12)]))
    write_page(
        file,
        title,
        [say_naming(summary), say_calibration(summary), say_withheld(summary)],
        [section for section in sections if section.blocks],
        kind="Self-test of the diagnosis",
        provenance=Provenance(facts, ["Sizes, noise, designs and backgrounds of the drawn campaigns are assumed."]),
    )


def say_naming(summary: Mapping[str, Any]) -> str:
    """Say how many effects were named."""
    named = [k for k in summary["kinds"] if k["all_named"] is not None]
    parts = [f"{k['kind']}, {k['difficulty']}: {_percent(k['all_named'])} of {k['campaigns']}" for k in named]
    precision = summary["claims"]["precision"]
    return (
        f"Names: all effects were named in {'; '.join(parts) or 'no campaign'}. Of {summary['claims']['count']} claims "
        f"{_percent(precision)} have something real behind them."
    )


def say_calibration(summary: Mapping[str, Any]) -> str:
    """Say whether probabilities hold."""
    error, wrong = summary["calibration"]["expected_error"], summary["claims"]["confident_wrong_share"]
    if error is None:
        return "Probabilities: nothing was claimed."
    return (
        f"Probabilities: stated ones differ from how often they hold by {format_number(error, 2)} on average; "
        f"{_percent(wrong)} of the claims are wrong and were stated with more than 0.8."
    )


def say_withheld(summary: Mapping[str, Any]) -> str:
    """Say what is answered when the true effect is no candidate."""
    withheld = summary["withheld"]["all"]
    if not withheld["campaigns"]:
        return "Withheld effects: none were withheld."
    return (
        f"Withheld effects: with the true effect taken from the candidates of {withheld['campaigns']} campaigns, "
        f"{_percent(withheld['honest'])} of the answers are honest, {_percent(withheld['unknown'])} are unknown, "
        f"and {withheld['confident_wrong']} hold a confident wrong name."
    )


def describe_study(summary: Mapping[str, Any]) -> str:
    """Write the summary in a few lines."""
    lines = [
        f"{k['kind']:17s} {k['difficulty']:9s} {k['campaigns']:4d} campaigns  "
        f"all named {_percent(k['all_named']):>6s}  nothing false {_percent(k['nothing_false']):>6s}  "
        f"status right {_percent(k['status_right']):>6s}  fresh/floor {k['fresh_over_floor_median']:.2f}  "
        f"worse {k['fresh_worse']}"
        for k in summary["kinds"]
    ]
    lines += [say_naming(summary), say_calibration(summary), say_withheld(summary)]
    ties, seconds = summary["ties"], summary["seconds"]
    lines.append(
        f"Ties: {_percent(ties['listed_share'])} of {ties['ties']} listed; {_percent(ties['idle_share'])} of "
        f"{ties['rivals_listed']} listed rivals are idle."
    )
    if seconds["median"] is not None:
        lines.append(f"Time: {seconds['median']:.1f} s a campaign (median), {seconds['max']:.1f} s at most.")
    return "\n".join(lines)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _rates(summary: Mapping[str, Any]) -> Section:
    heads = [
        Column("kind"), Column("difficulty"), Column("campaigns"), Column("all named"), Column("nothing false"),
        Column("false names a case"), Column("status right"), Column("unknown or partly"),
        Column("later gap over floor"), Column("at the floor"), Column("nominal over floor"),
        Column("worse than nominal"),
    ]  # fmt: skip
    rows: list[Row] = [
        [k["kind"], k["difficulty"], k["campaigns"], _percent(k["all_named"]), _percent(k["nothing_false"]),
         k["false_names_a_case"], _percent(k["status_right"]), _percent(k["unknown_or_partly"]),
         k["fresh_over_floor_median"], _percent(k["at_the_floor"]), k["nominal_over_floor_median"], k["fresh_worse"]]
        for k in summary["kinds"]
    ]  # fmt: skip
    ties = summary["ties"]
    text = (
        f"Of {ties['ties']} named effects that other effects explain as well, {_percent(ties['listed_share'])} list at "
        f"least one of them; {_percent(ties['idle_share'])} of the listed rivals could not have made the gap."
    )
    return Section("What was named", [PageTable(heads, rows, "Medians of the later campaign's gap."), text])


def _calibration(summary: Mapping[str, Any]) -> Section:
    import plotly.graph_objects as go

    bins = summary["calibration"]["bins"]
    if not bins:
        return Section("Whether probabilities hold", [])
    stated, held = [b["stated"] for b in bins], [b["right"] for b in bins]
    figure = go.Figure()
    figure.add_scatter(x=[0.5, 1.0], y=[0.5, 1.0], mode="lines", line={"dash": "dot"}, name="as stated")
    figure.add_scatter(
        x=stated, y=held, mode="lines+markers", name="claims", text=[f"{b['claims']} claims" for b in bins],
        error_y={"type": "data", "symmetric": False, "array": [b["high"] - b["right"] for b in bins],
                 "arrayminus": [b["right"] - b["low"] for b in bins]},
    )  # fmt: skip
    figure.update_layout(xaxis_title="stated probability", yaxis_title="share that holds", yaxis_range=[0, 1.02])
    rows: list[Row] = [[f"{b['from']:g} to {b['to']:g}", b["claims"], b["stated"], b["right"]] for b in bins]
    heads = [Column("stated"), Column("claims"), Column("stated, mean"), Column("holds")]
    return Section("Whether probabilities hold", [
        Columns([[Chart(figure, "Claims by stated probability; bars: 95 % intervals.", 340)], [PageTable(heads, rows)]])
    ])  # fmt: skip


def _confusion(summary: Mapping[str, Any]) -> Section:
    import plotly.graph_objects as go

    confusion = summary["confusion"]
    if not confusion["rows"]:
        return Section("What was taken for what", [])
    counts = confusion["counts"]
    figure = go.Figure(
        go.Heatmap(
            z=counts, x=[c.replace("_", " ") for c in confusion["columns"]],
            y=[r.replace("_", " ") for r in confusion["rows"]], colorscale="Blues",
            text=[[str(n) if n else "" for n in row] for row in counts], texttemplate="%{text}", showscale=False,
        )
    )  # fmt: skip
    figure.update_layout(xaxis_title="named", yaxis_title="there", margin={"l": 170, "b": 150})
    figure.update_yaxes(autorange="reversed")
    caption = (
        "Rows: what is there; columns: what is named for it. A named effect that the campaign cannot tell from the "
        "true one stands in the true one's row."
    )
    return Section("What was taken for what", [Chart(figure, caption, 180 + 26 * len(confusion["rows"]))])


def _detection(summary: Mapping[str, Any]) -> Section:
    import plotly.graph_objects as go

    table = summary["detection"]
    if not table:
        return Section("How large an effect has to be", [])
    figure = go.Figure()
    for alone, name in ((True, "alone"), (False, "beside others")):
        part = [d for d in table if d["alone"] == alone]
        figure.add_scatter(
            x=[_bin(d) for d in part], y=[d["named"] for d in part], mode="lines+markers", name=name,
            text=[f"{d['effects']} effects" for d in part],
            error_y={"type": "data", "symmetric": False, "array": [d["high"] - d["named"] for d in part],
                     "arrayminus": [d["named"] - d["low"] for d in part]},
        )  # fmt: skip
    order = list(dict.fromkeys(_bin(d) for d in sorted(table, key=lambda d: d["from"])))
    figure.update_xaxes(categoryorder="array", categoryarray=order, title="gap over noise of one coordinate")
    figure.update_layout(yaxis_title="share named", yaxis_range=[0, 1.02])
    return Section("How large an effect has to be", [Chart(figure, "Effects named, by the size of their gap.", 340)])


def _bin(entry: Mapping[str, Any]) -> str:
    return f"{entry['from']:g} to {entry['to']:g}" if entry["to"] is not None else f"above {entry['from']:g}"


def _withheld(summary: Mapping[str, Any]) -> Section:
    rows: list[Row] = [
        [e["effect"].replace("_", " "), e["campaigns"], _percent(e["honest"]), _percent(e["unknown"]),
         _percent(e["rival_named"]), _percent(e["predicts_later"]), e["false_names_a_case"],
         TableCell(e["confident_wrong"], "bad" if e["confident_wrong"] else ""), e["fresh_worse"]]
        for e in summary["withheld"]["effects"]
    ]  # fmt: skip
    heads = [
        Column("effect withheld"), Column("campaigns"), Column("honest"), Column("unknown"),
        Column("a true rival named"), Column("later campaign at the floor"), Column("false names a case"),
        Column("confident wrong names"), Column("worse than nominal"),
    ]  # fmt: skip
    caption = (
        "The true effect is left out of the candidates. Honest: unknown, partly explained, or only effects that the "
        "campaign cannot tell from the true one. A false name whose robot predicts the later campaign down to the "
        "floor may be several effects that do together what the true one does."
    )
    blocks: list[Block] = [PageTable(heads, rows, caption)] if rows else []
    return Section("What is said when the true effect is no candidate", blocks)
