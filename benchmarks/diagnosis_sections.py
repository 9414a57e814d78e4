"""Sections of the page that sets the diagnosis beside its rivals: classes, probabilities, predictions, real data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.answer_scores import BESIDE, CONFIDENT, Score
from compplan.reporting import figure as go
from compplan.reporting.page import Block, Chart, Column, Columns, Fold, PageTable, Row, Section, TableCell
from compplan.reporting.style import AFTER, BEFORE, NEUTRAL, TOLERANCE, format_number

Table = Mapping[str, Any]
#: Words and colours of the contestants.
WORDS = {
    "before": "product before",
    "product": "product",
    "rival": "plain rival",
    "figaroh": "FIGAROH",
    "geometry": "plain calibration",
}
COLOURS = {"before": NEUTRAL, "product": AFTER, "rival": BEFORE, "figaroh": TOLERANCE, "geometry": "#78606c"}
#: Shares of which a small one is good.
BAD = ("wrong among", "later campaign", "stated error", "no answer")
FIGURES = (
    ("calibration_error", "calibration error of claims"),
    ("false_names_per_unknown", "false names an unknown cause"),
    ("stated_off_median", "stated against true error, median off by"),
    ("fresh_over_floor_median", "later campaign over noise floor, median"),
    ("nominal_over_floor_median", "the same with the nominal robot"),
    ("seconds_median", "CPU time, median, s"),
)


def word_of(contestant: str) -> str:
    """Return how a contestant is called on the page."""
    return WORDS.get(contestant, contestant)


def show_share(part: Table | None) -> str:
    """Write a share with its count and interval."""
    if part is None or not part["count"]:
        return "–"
    low, mid, high = (round(100 * part[key]) for key in ("low", "share", "high"))
    return f"{mid} % ({low}–{high}), {part['hits']} of {part['count']}"


def compare_classes(title: str, summaries: Mapping[str, Table], cases: int) -> Section:
    """Set the shares of all classes side by side, with the figures that are no shares."""
    names = [n for n in summaries if n in ("before", "product", "rival")]
    keys = [k for k in summaries[names[0]]["shares"] if any(_count(summaries[n], k) for n in names)]
    rows: list[Row] = [[key, *(show_share(summaries[n]["shares"].get(key)) for n in names)] for key in keys]
    for key, words in FIGURES:
        rows.append([words, *(_number(summaries[n].get(key)) for n in names)])
    heads = [Column("class"), *(Column(word_of(n)) for n in names)]
    caption = f"{cases} campaigns. In brackets the 95 % interval of the share in percent (Wilson 1927)."
    return Section(title, [_dots(names, keys, summaries), PageTable(heads, rows, caption)])


def _count(summary: Table, key: str) -> int:
    return int(summary["shares"].get(key, {"count": 0})["count"])


def _number(value: float | None) -> str:
    return "–" if value is None else format_number(float(value), 2)


def _dots(names: Sequence[str], keys: Sequence[str], summaries: Mapping[str, Table]) -> Chart:

    figure = go.Figure()
    labels = [f"{key} ↓" if key.startswith(BAD) else key for key in keys]
    for k, name in enumerate(names):
        found = [(i, summaries[name]["shares"][key]) for i, key in enumerate(keys) if _count(summaries[name], key)]
        share = [100 * part["share"] for _, part in found]
        figure.add_scatter(
            x=share, y=[i + 0.22 * (k - 0.5 * (len(names) - 1)) for i, _ in found], mode="markers", name=word_of(name),
            marker={"color": COLOURS.get(name, NEUTRAL), "size": 9},
            text=[show_share(part) for _, part in found], hovertemplate="%{text}",
            error_x={"type": "data", "symmetric": False, "thickness": 1.4, "width": 3,
                     "array": [100 * part["high"] - s for (_, part), s in zip(found, share, strict=True)],
                     "arrayminus": [s - 100 * part["low"] for (_, part), s in zip(found, share, strict=True)]},
        )  # fmt: skip
    figure.update_yaxes(tickvals=list(range(len(keys))), ticktext=labels, autorange="reversed", automargin=True)
    figure.update_xaxes(range=[-2, 102], title="share, %")
    caption = "Shares with 95 % intervals. An arrow marks shares of which a small one is good."
    return Chart(figure, caption, 110 + 34 * len(keys))


def judge_probabilities(summaries: Mapping[str, Table]) -> Section:
    """Show how often claims hold that were stated with some probability."""

    figure = go.Figure()
    line = {"dash": "dot", "color": NEUTRAL}
    figure.add_scatter(x=[0.5, 1], y=[0.5, 1], mode="lines", line=line, name="as stated")
    for name in [n for n in summaries if summaries[n]["calibration"]]:
        bins = summaries[name]["calibration"]
        figure.add_scatter(
            x=[b["stated"] for b in bins], y=[b["share"] for b in bins], mode="lines+markers", name=word_of(name),
            line={"color": COLOURS.get(name, NEUTRAL)}, text=[show_share(b) for b in bins], hovertemplate="%{text}",
            error_y={"type": "data", "symmetric": False, "array": [b["high"] - b["share"] for b in bins],
                     "arrayminus": [b["share"] - b["low"] for b in bins]},
        )  # fmt: skip
    figure.update_layout(xaxis_title="stated probability", yaxis_title="share that holds", yaxis_range=[0, 1.03])
    return Section("Whether probabilities hold", [Chart(figure, "All suites; bars: 95 % intervals.", 360)])


def compare_predictions(scores: Mapping[str, Sequence[Score]]) -> Section:
    """Show how far off a later campaign is that nobody had seen, over its noise floor."""

    figure = go.Figure()
    rows: list[Row] = []
    nominal = next(iter(scores.values()))
    sets = {"nominal robot": [s.nominal / s.floor for s in nominal]}
    sets |= {word_of(name): [s.fresh / s.floor for s in part] for name, part in scores.items()}
    for name, ratios in sets.items():
        good = np.sort([r for r in ratios if np.isfinite(r)])
        if len(good):
            key = next((k for k, w in WORDS.items() if w == name), "")
            colour = COLOURS.get(key, "#444a52")
            figure.add_scatter(
                x=good, y=100 * np.arange(1, len(good) + 1) / len(good), mode="lines", name=name, line={"color": colour}
            )
            rows.append([name, len(good), *(float(np.quantile(good, q)) for q in (0.25, 0.5, 0.75, 0.9))])
    figure.update_xaxes(type="log", title="rms of the later campaign over its noise floor")
    figure.update_yaxes(title="campaigns, %", range=[0, 101])
    heads = [Column("robot"), Column("campaigns"), *(Column(f"{q} %") for q in (25, 50, 75, 90))]
    text = "Each campaign has a later one of the same robot, new poses and loads, that no contestant was given."
    chart = Chart(figure, "Share of campaigns that are predicted at least so well.", 360)
    table = PageTable(heads, rows, "Quantiles over campaigns.")
    return Section("How a later campaign is predicted", [text, Columns([[chart], [table]], (1.3, 1.0))])


def describe_answer(score: Score) -> str:
    """Write a verdict in one line."""
    claims = ", ".join(f"{c.label.replace('_', ' ')} {c.probability:.2f}" for c in score.claims)
    return f"{score.status.replace('_', ' ')}{': ' if claims else ''}{claims}"


def list_answers(title: str, truths: Sequence[Table], scores: Mapping[str, Sequence[Score]]) -> Section:
    """List labelled campaigns with what was there and what each contestant said."""
    names = [n for n in scores if n in ("before", "product", "rival")]
    rows: list[Row] = []
    for k, truth in enumerate(truths):
        part = [scores[n][k] for n in names]
        there = ", ".join(_there(e) for e in truth["effects"]) or "nothing"
        cells = [TableCell(describe_answer(s), _tone(s)) for s in part]
        product = scores.get("product", part)[k] if "product" in scores else part[0]
        rows.append([part[0].case.split("__")[-1], truth["kind"], there, *cells, product.stated, product.fresh])
    heads = [Column("campaign"), Column("kind"), Column("there"), *(Column(f"{word_of(n)} says") for n in names)]
    heads += [Column("stated", "mm"), Column("true", "mm")]
    caption = (
        "Green: everything required is named, nothing false; red: a false name; plain: something is missed, or an "
        "unknown cause is not mentioned. Stated and true error of the product's updated robot on later rows."
    )
    return Section(title, [PageTable(heads, rows, caption)])


def _there(effect: Table) -> str:
    words = [effect.get("kind") or effect["effect"], effect.get("joint"), effect.get("axis")]
    text = " ".join(str(w).replace("_", " ") for w in words if w)
    text = f"unknown: {text}" if effect["effect"] == "unknown" else text
    return text if effect.get("required", True) else f"({text}, cannot be seen)"


def _tone(score: Score) -> str:
    if not score.clean:
        return "bad"
    if score.kind == "unknown":
        return "good" if score.status in ("unknown", "partly_explained") else ""
    if score.kind in BESIDE and score.status == "explained":
        return ""
    return "good" if score.complete else ""


def show_real(parts: Mapping[str, Mapping[str, Score]], repeats: Mapping[str, tuple[int, int]], name: str) -> Section:
    """Show a real campaign: whole, mirror, halves and thinned, stated against true error on rows not used."""
    contestants = list(next(iter(parts.values())))
    rows: list[Row] = []
    for part, scores in parts.items():
        for contestant in contestants:
            s = scores[contestant]
            off = s.stated / s.fresh if s.fresh else float("nan")
            tone = "" if not np.isfinite(off) else "bad" if off < 0.8 else "good" if abs(off - 1.0) <= 0.1 else ""
            said = describe_answer(s) if contestant in ("before", "product", "rival") else "names nothing"
            rows.append([part.replace("_", " "), word_of(contestant), s.stated, s.fresh, TableCell(off, tone), said])
    heads = [Column("rows given"), Column("contestant"), Column("stated", "mm"), Column("true", "mm")]
    heads += [Column("stated over true"), Column("answer")]
    nominal = next(iter(next(iter(parts.values())).values())).nominal
    text = (
        f"{name}: the registered nominal robot is {format_number(nominal, 3)} mm off (rms of rows given to nobody). "
        "Mirror: all deviations negated, a mistake of sign; mirror control: the same poses as measured. Halves and the "
        "two parts of a size share no pose."
    )
    repeated = [
        f"{word_of(c)}: {hits} of {count} claims stated {CONFIDENT:g} and more repeat where no pose is shared."
        for c, (hits, count) in repeats.items()
    ]
    table = PageTable(heads, rows, "Stated: held-out error of the answer; true: error on rows given to nobody.", 24)
    blocks: list[Block] = [text, _learning(parts, contestants), *repeated, Fold("Every part and contestant", [table])]
    return Section("A real robot", blocks)


def _learning(parts: Mapping[str, Mapping[str, Score]], contestants: Sequence[str]) -> Chart:

    figure = go.Figure()
    thin = [p for p in parts if p.startswith("thin_") and p.endswith("a")]
    count = [int(p.split("_")[1]) for p in thin]
    for c in contestants:
        for key, dash in (("fresh", "solid"), ("stated", "dot")):
            y = [getattr(parts[p][c], key) for p in thin]
            if np.isfinite(y).any():
                word = f"{word_of(c)}, {'true' if key == 'fresh' else 'stated'}"
                line = {"color": COLOURS.get(c, NEUTRAL), "dash": dash}
                shown = [v if np.isfinite(v) else None for v in y]
                figure.add_scatter(x=count, y=shown, mode="lines+markers", name=word, line=line)
    figure.update_xaxes(type="log", title="poses given", tickvals=count, ticktext=[str(n) for n in count])
    figure.update_yaxes(title="rms error, mm", type="log")
    return Chart(figure, "What the diagnosis of fewer poses is worth: error on rows given to nobody, and stated.", 400)


def list_wrong(scores: Mapping[str, Sequence[Score]]) -> Section:
    """List the product's false names and missed effects."""
    rows: list[Row] = [
        [s.case.replace("__", " "), s.kind, ", ".join(s.missed) or "–",
         ", ".join(f"{c.label} {c.probability:.2f}" for c in s.claims if not c.right) or "–",
         s.status.replace("_", " ")]
        for s in scores["product"]
        if s.missed or not s.clean or s.status == "refused"
    ]  # fmt: skip
    heads = [Column("campaign"), Column("kind"), Column("missed"), Column("false"), Column("status")]
    blocks: list[Block] = [PageTable(heads, rows, "Every wrong answer of the product.", 20)] if rows else ["None."]
    return Section("Wrong answers", [Fold(f"{len(rows)} campaigns", blocks)])
