"""Which depth and which spindle speed a cut may have: proposals that are as good as the probabilities of chatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compplan.io.tables import Array
from compplan.process.stability import CutDynamics, Spread, find_odds

#: Probability of chatter that is accepted (assumed), and cuts nearest to chatter that have to keep it.
ACCEPTED, CUTS = 0.1, 5
#: Shares of the job's depth that are tried, greatest first, and other speeds that are.
SHARES, SPEEDS = (3.0, 2.0, 1.5, 1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.12, 0.07, 0.04), 5


@dataclass(frozen=True)
class CutProposal:
    """The deepest cut of those tried that keeps the accepted probability, and a speed that does at full depth.

    Attributes:
        share: Depth at the job's speed, to the job's; None where none of those tried keeps it.
        depth: The same at the waypoint nearest to chatter. [m]
        speed: Spindle speed at the job's depth and feed a tooth; None where none is needed or none was found. [1/s]
        odds: Probability of chatter there.

    """

    share: float | None
    depth: float | None
    speed: float | None
    odds: float | None

    @property
    def sentence(self) -> str:
        """Say it."""
        if self.share is None:
            deep = f"no depth down to {SHARES[-1]:g} of the job's keeps it below {100 * ACCEPTED:.0f} %"
        else:
            size = f"{1e3 * (self.depth or 0.0):.3g} mm, {self.share:g} of the job's depth"
            deep = f"{size}, keeps it below {100 * ACCEPTED:.0f} %" + (", and so does the job's" * (self.share > 1.0))
        words = f" Proposed, at the {CUTS} cuts nearest to chatter and their engaged arc: at the job's speed {deep}"
        if self.speed is not None:
            words += (f"; at its depth and feed a tooth {60.0 * self.speed:.4g} 1/min does, with up to "
                      f"{100 * (self.odds or 0.0):.0f} %")  # fmt: skip
        elif self.share is None or self.share < 1.0:
            words += "; none of the other speeds tried does at its depth"
        return words + "."


def propose_cut(
    cuts: Sequence[CutDynamics], spread: Spread, speed: float, depth: float, speeds: Array, limits: Array
) -> CutProposal:
    """Propose depth and speed.

    Args:
        cuts: Cuts of a path, the one nearest to chatter first.
        spread: How surely they are known.
        speed: The job's spindle speed. [1/s]
        depth: Its depth at the cut nearest to chatter. [m]
        speeds: Speeds of a map. Shape (a,). [1/s]
        limits: Depth that the zero-order solution allows there, inf for any. Shape (a,). [m]

    """

    def worst(share: float, faster: float) -> float:
        most = 0.0
        for cut in cuts[:CUTS]:
            most = max(most, find_odds(cut.scaled(share, faster), spread))
            if most > ACCEPTED:
                break
        return most

    share = next((each for each in SHARES if worst(each, 1.0) <= ACCEPTED), None)
    deep = None if share is None else share * depth
    if share is not None and share >= 1.0:
        return CutProposal(share, deep, None, None)
    order = np.argsort(-np.where(np.isfinite(limits), limits, 1e9), kind="stable")[:SPEEDS]
    tried = [(worst(1.0, float(speeds[i]) / speed), float(speeds[i])) for i in order if limits[i] > depth]
    odds, faster = min(tried, default=(1.0, speed))
    found = (faster, odds) if odds <= ACCEPTED else (None, None)
    return CutProposal(share, deep, *found)
