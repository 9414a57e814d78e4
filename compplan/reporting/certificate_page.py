"""The page of a certificate: one look at how a robot stands today."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.learning.certificate import DRIFTED, Certificate, Named
from compplan.learning.iso9283 import VISITS, PoseAccuracy
from compplan.reporting import figure as go
from compplan.reporting.effect_words import describe_change
from compplan.reporting.openings import open_certificate
from compplan.reporting.page import Block, Chart, Column, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.style import AFTER, BEFORE, CATEGORIES, format_length, format_number
from compplan.uncertainty.assumed import list_assumed

GRADES = {"measured": "measured", "literature": "assumed for a robot model from published data", "assumed": "assumed"}


def write_certificate_page(certificate: Certificate, file: Path) -> None:
    """Write the page of a certificate.

    Args:
        certificate: The certificate.
        file: The HTML file.
    """
    sections = [_reach(certificate), _stiffness(certificate), _drives(certificate)]
    if certificate.accuracy is not None:
        sections.insert(0, _accuracy(certificate.accuracy, certificate.log))
    if certificate.older is not None:
        sections.append(_drift(certificate))
    lede = "To measure or to repair, most useful first."
    steps: list[Row] = [[step] for step in certificate.next_steps]
    sections.append(Section("What next", [PageTable([Column("")], steps or [["nothing stands out"]])], lede))
    robot, same = certificate.robot, certificate.literature
    name = robot.name if same is None or same.name == robot.name else f"{same.name} ({robot.name})"
    provenance = describe_robot(robot, [("known from", certificate.known.source)], list_assumed(robot))
    write_page(file, f"{name}: certificate", describe_certificate(certificate), sections, kind="Robot certificate",
               opening=open_certificate(certificate, _picture(certificate)),
               provenance=provenance)  # fmt: skip


def describe_certificate(certificate: Certificate) -> str:
    """Say in a few sentences how the robot stands."""
    known, accuracy = certificate.known, certificate.accuracy
    text = f"How surely this robot is known is {GRADES[known.grade]}."
    reached = [r for r in certificate.references if r.promise is not None]
    for reference in reached:
        if reference.promise is not None:
            band = format_length(reference.promise.whole)
            text += f" On the {reference.name} it keeps a tolerance of {band} with 95\u00a0%."
    if certificate.log and accuracy is None:
        text += " The log holds no positions: accuracy and repeatability of ISO 9283 are not in it."
    if accuracy is not None and accuracy.again:
        text += f" Its repeatability RP is {format_length(accuracy.pooled)} over {_met_again(accuracy)}."
    if certificate.findings:
        text += f" The diagnosis of {certificate.log or 'the log'} names {'; '.join(map(_name, certificate.findings))}."
    changed = f"; the stiffness of {', '.join(certificate.changed)} differs beyond chance"
    if certificate.older is not None:
        worst = max((most for _, _, most in certificate.moved), default=0.0)
        since = " Since the last certificate the tip has moved by up to"
        if not certificate.drifts:
            since = f" Against {certificate.older.name}, whose figures nobody measured, the tip goes elsewhere by up to"
        text += f"{since} {format_length(worst)}"
        text += f"{changed}." if certificate.changed else "; no stiffness differs beyond chance."
    return text


def _name(finding: Named) -> str:
    """Name a finding as the diagnosis does, with the change of a joint's compliance."""
    words = " ".join(part for part in (finding.effect.replace("_", " "), finding.joint, finding.axis) if part)
    if finding.percent is None:
        return words
    return f"{words}: compliance {describe_change({'change_percent': finding.percent})} (95 %)"


def _met_again(accuracy: PoseAccuracy) -> str:
    return f"{accuracy.again} pose{'' if accuracy.again == 1 else 's'} met again"


def _accuracy(accuracy: PoseAccuracy, log: str) -> Section:
    rows: list[Row] = [
        ["poses in the log", accuracy.poses, ""],
        ["accuracy AP, median over poses", format_length(float(np.median(accuracy.accuracy))), ""],
        ["accuracy AP, greatest", format_length(float(accuracy.accuracy.max())), ""],
        ["accuracy AP before frames were fitted", format_length(float(accuracy.raw.max())), "greatest"],
        ["distance from the model, rms of rows", format_length(accuracy.rms), ""],
    ]
    if len(accuracy.unseen):
        unseen = format_length(float(accuracy.unseen.max()))
        rows.insert(4, ["accuracy AP of poses that the fit never saw", unseen, "greatest"])
    if accuracy.again:
        visits = f"{int(accuracy.visits.min())} to {int(accuracy.visits.max())} visits"
        low, high = (format_length(value) for value in accuracy.pooled_interval)
        around = f"{low} to {high} (95 %); {visits}"
        rows.append(["repeatability RP", TableCell(format_length(accuracy.pooled), "strong"), around])
    else:
        rows.append(["repeatability RP", TableCell("no pose was met again", "muted"), ""])
    said = f"the instrument's {format_length(accuracy.instrument)} per axis is taken out"
    out = said if accuracy.instrument else "no sigma_mm is stated, the instrument is in it"
    caption = (
        f"As ISO 9283 defines them, from {log or 'the log'}; the standard asks for {VISITS} visits from one side under"
        f" full load. RP is what {VISITS} visits are expected to give, from the scatter of {accuracy.freedom} visits"
        f" beyond the first of a pose; {out}. Fitted first: {' and '.join(accuracy.registered)}, {accuracy.fitted}"
        f" numbers to {3 * accuracy.poses}; AP is what is left of the model."
    )
    return Section("Accuracy and repeatability", [PageTable([Column(""), Column("value"), Column("")], rows, caption)])


def _reach(certificate: Certificate) -> Section:
    rows: list[Row] = []
    for reference in certificate.references:
        force = f"{format_number(float(np.linalg.norm(reference.force)))} N"
        if reference.promise is None:
            rows.append([reference.name, force, None, None, None, TableCell(reference.reason[:120], "muted")])
            continue
        promise, centre = reference.promise, reference.centre
        place = "–" if centre is None else ", ".join(f"{1e3 * v:.0f}" for v in centre)
        rows.append(
            [reference.name, force, place, 1e3 * promise.greatest, TableCell(1e3 * promise.whole, "strong"),
             promise.leading[0][0] if promise.leading else None]
        )  # fmt: skip
    columns = [
        Column("reference path"), Column("force"), Column("centre", "mm"), Column("any point, 95 %", "mm"),
        Column("whole path, 95 %", "mm"), Column("most of it from"),
    ]  # fmt: skip
    caption = (
        "Tolerance that is kept after correction, the force known exactly. Circles of the robot's own size:"
        " place and force (the weight of the rated payload, or 50 N a metre of reach) are assumed; --job takes a path"
        " of your own."
    )
    return Section("Tolerance within reach", [PageTable(columns, rows, caption)])


def _stiffness(certificate: Certificate) -> Section:
    rows: list[Row] = []
    for entry in certificate.stiffness:
        drifted = entry.change is not None and abs(entry.change) > DRIFTED
        past: Row = [_mega(entry.older), TableCell(entry.change, "bad" if drifted else "")]
        past = [] if certificate.older is None else past
        outside = entry.literature is not None and not entry.low <= entry.literature <= entry.high
        literature = TableCell(_mega(entry.literature), "bad" if outside else "")
        rows.append([entry.joint, _mega(entry.value), _mega(entry.low), _mega(entry.high), literature, *past])
    columns = [
        Column("joint"), Column("stiffness", "MN m/rad"), Column("from"), Column("to"), Column("published"),
    ]  # fmt: skip
    if certificate.older is not None:
        columns += [Column("last time"), Column("change", "standard deviations", 2)]
    named = certificate.literature
    source = "no shipped robot of this type"
    if named is not None:
        source = f"{named.name}, {named.sources.get('compliance', '')}"
    lede = f"With 95 % intervals, {GRADES[certificate.known.grade]}. Published: {source}."
    blocks: list[Block] = [PageTable(columns, rows, "Infinite: the model holds the joint rigid. MN/m where it slides.")]
    return Section("Stiffness", blocks, lede)


def _picture(certificate: Certificate) -> Chart | None:
    """Return the stiffness of the joints; None where the model holds all of them rigid."""
    if not any(np.isfinite(entry.value) for entry in certificate.stiffness):
        return None
    caption = "Stiffness of each joint. Dots: today; lines: 95 % intervals."
    return Chart(_draw_stiffness(certificate), caption, height=340)


def _draw_stiffness(certificate: Certificate) -> Any:

    entries = [entry for entry in certificate.stiffness if np.isfinite(entry.value)]
    names = [entry.joint for entry in entries]
    value = np.array([entry.value for entry in entries]) * 1e-6
    low = np.array([entry.low for entry in entries]) * 1e-6
    high = np.array([min(entry.high, 10.0 * entry.value) for entry in entries]) * 1e-6
    figure = go.Figure()
    bars = {"type": "data", "array": high - value, "arrayminus": value - low, "thickness": 1.6}
    figure.add_scatter(x=names, y=value, error_y=bars, mode="markers", name="today", marker={"color": AFTER, "size": 9})
    others = (("published", CATEGORIES[1], "literature"), ("last time", BEFORE, "older"))
    for label, colour, key in others:
        points = [getattr(entry, key) for entry in entries]
        if any(point is not None for point in points):
            y = [None if p is None or not np.isfinite(p) else 1e-6 * p for p in points]
            marker = {"color": colour, "size": 9, "symbol": "diamond-open"}
            figure.add_scatter(x=names, y=y, mode="markers", name=label, marker=marker)
    ticks = [step * 10.0**power for power in range(-6, 7) for step in (1, 2, 5)]
    names = [f"{tick:g}" for tick in ticks]
    figure.update_yaxes(title_text="stiffness, MN m/rad", type="log", tickvals=ticks, ticktext=names)
    return figure


def _drives(certificate: Certificate) -> Section:
    rows: list[Row] = []
    for drive in certificate.drives:
        past: Row = [] if certificate.older is None else [_micro(drive.older_play)]
        cells: Row = []
        for size, spread, before in ((drive.play, drive.play_spread, past), (drive.gear, drive.gear_spread, [])):
            looked = size > 0 or spread is not None
            cells += [_micro(size), _micro(spread), 1e3 * size * drive.lever] if looked else [None, None, None]
            cells += before
        rows.append([drive.joint, *cells])
    columns = [Column("joint"), Column("lost motion", "µrad"), Column("95 % ±", "µrad"), Column("at the tip", "mm")]
    columns += [Column("last time", "µrad")] if certificate.older is not None else []
    columns += [Column("gear error", "µrad"), Column("95 % ±", "µrad"), Column("at the tip", "mm")]
    caption = (
        "Lost motion: full width. Gear error: amplitude. At the tip: at its farthest from the joint on the paths above."
        " A dash: nobody has looked."
    )
    return Section("Lost motion and gear error", [PageTable(columns, rows, caption)], "µm for joints that slide.")


def _drift(certificate: Certificate) -> Section:
    rows: list[Row] = [[name, 1e3 * rms, TableCell(1e3 * most, "strong")] for name, rms, most in certificate.moved]
    columns = [Column("reference path"), Column("rms", "mm"), Column("greatest", "mm")]
    older = certificate.older
    last = "" if older is None or older.folder is None else "/".join(Path(older.folder).parts[-2:])
    lede = f"Where the tip goes at the same commands, today against the folder {last}."
    title = "Drift since the last certificate" if certificate.drifts else "Against a folder that was not measured"
    return Section(title, [PageTable(columns, rows)], lede)


def _mega(value: float | None) -> float | None:
    return None if value is None else 1e-6 * value


def _micro(value: float | None) -> float | None:
    return None if value is None else 1e6 * value
