"""The section of a plan's page on force and place: the uncorrected tip without and with their coupling."""

from __future__ import annotations

from compplan.plan.coupling import CouplingEffect
from compplan.reporting.page import Block, Column, PageTable, Row, Section, TableCell
from compplan.reporting.style import format_length, format_number, format_percent


def show_coupling(effect: CouplingEffect) -> Section:
    """Return the section."""
    rows: list[Row] = []
    for k, name in enumerate("xyz"):
        stiffness = f"{format_number(1e-3 * float(effect.stiffness[k]))}\u00a0N/mm"
        sizes = [format_length(float(side[k])) for side in (effect.without, effect.coupled)]
        rows.append([name, TableCell(stiffness), *map(TableCell, sizes),
                     TableCell(format_percent(float(effect.left[k])), "strong")])  # fmt: skip
    for name, k in (("distance, rms", 0), ("distance, largest", 1)):
        pair = effect.without_size[k], effect.coupled_size[k]
        share = pair[1] / pair[0] if pair[0] > 0.0 else 1.0
        rows.append([name, None, *(TableCell(format_length(value)) for value in pair),
                     TableCell(format_percent(share), "strong")])  # fmt: skip
    settled = effect.settled
    verdict = settled.explain() or (
        f"Force and deflection agree after {settled.passes} passes; each moves the tip by at most "
        f"{format_number(settled.ratio, 2)} of the pass before."
    )
    columns = [Column("base axis"), Column("process stiffness"), Column("force on the path"),
               Column("force where the tool is"), Column("left")]  # fmt: skip
    caption = "Root mean square deviation of the uncorrected tip over the cut in contact."
    blocks: list[Block] = [f"Process stiffness: {effect.source}. {verdict}", PageTable(columns, rows, caption)]
    text = ("The tool that gives way meets another force. Corrected, it stands on the path and meets the force there: "
            "the correction is the same with and without.")  # fmt: skip
    return Section("Force and place", blocks, text)
