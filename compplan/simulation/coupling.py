"""Force and deflection in turn, where the force depends on where the loaded tool is.

With C the compliance of the tip and K the process stiffness the wrench w that acts on a tool off its path by d fulfils
w = w0 + r(d(w)), r the response of the process, -K d to first order. A pass takes the step (1 + K C)^-1 of what is
missing; plain repetition would grow wherever the process is stiffer than the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from compplan.robot import Array
from compplan.simulation.cell import CellRun

#: Passes at most, and the motion of the tip that needs no further one. [m]
PASSES, EXACT = 3, 1e-7
#: Share of the first pass's motion that the last may still ask for.
LEFT = 0.02
#: Passes are measured at this share of the waypoints in contact: where a cut begins or ends a sliver comes and goes.
SHARE = 0.95


@dataclass(frozen=True)
class Settled:
    """Where force and deflection agree.

    Attributes:
        run: Where the loaded tool is.
        wrench: The wrench that acts there. Shape (n, 6). [N, N m]
        steps: Motion of the tip that each pass asked for at 95 % of the waypoints in contact, at most; the last is what
            is still missing. [m]
        missing: What the last pass still asks of the tip. Shape (n,). [m]
        margin: Least real part of the eigenvalues of 1 + K C: at 0 or below the process pushes the tool on faster than
            the arm holds it.

    """

    run: CellRun
    wrench: Array
    steps: tuple[float, ...]
    missing: Array
    margin: float

    @property
    def passes(self) -> int:
        """Passes taken."""
        return len(self.steps) - 1

    @property
    def ratio(self) -> float:
        """Greatest ratio of a pass's motion to that of the pass before, 0 where one was enough."""
        pairs = zip(self.steps[1:], self.steps[:-1], strict=True)
        return max((after / before for after, before in pairs if after > EXACT), default=0.0)

    @property
    def agrees(self) -> bool:
        """Tell whether the passes contracted, and far enough."""
        return self.margin > 0.0 and self.ratio < 1.0 and self.steps[-1] <= self.allowed

    @property
    def allowed(self) -> float:
        """What may still be missing. [m]"""
        return max(EXACT, LEFT * self.steps[0])

    @property
    def unsettled(self) -> float:
        """Share of the waypoints in contact at which more is missing."""
        touches = np.abs(self.wrench[:, :3]).max(axis=1) > 0.0
        return float((self.missing[touches] > self.allowed).mean()) if touches.any() else 0.0

    @property
    def worst(self) -> int:
        """The waypoint at which most is missing."""
        return int(self.missing.argmax())

    def explain(self) -> str:
        """Say in a sentence that they do not agree, and where least; nothing where they do."""
        if self.agrees:
            return ""
        if self.margin <= 0.0:
            return ("Force and deflection do not agree: as the tool leaves the path the process pushes it on faster "
                    f"than the arm holds it (least eigenvalue of 1 + K C {self.margin:.3g}).")  # fmt: skip
        return (f"Force and deflection do not agree in {self.passes} passes: the last still asks for "
                f"{1e3 * self.steps[-1]:.2g} mm, the first did for {1e3 * self.steps[0]:.2g} mm, greatest ratio of a "
                f"pass to the one before {self.ratio:.2g}; {100 * self.unsettled:.3g} % of the waypoints in contact "
                f"miss it, waypoint {self.worst} by the most, {1e3 * self.missing[self.worst]:.2g} mm.")  # fmt: skip


def settle_coupled(
    attain: Callable[[Array], CellRun],
    respond: Callable[[Array], Array],
    *,
    position: Array,
    wrench: Array,
    compliance: Array,
    stiffness: Array,
) -> Settled:
    """Let force and deflection agree.

    Args:
        attain: Where the tool goes under a wrench.
        respond: By how much the wrench changes where the tool is off its path by (n, 3) [m]. Shape (n, 6).
        position: Wanted tip. Shape (n, 3). [m]
        wrench: The wrench on a tool that stands there. Shape (n, 6). [N, N m]
        compliance: Of the tip, forces alone. Shape (n, 3, 3). [m/N]
        stiffness: Of the process, about. Shape (n, 3, 3). [N/m]

    """
    inner = np.eye(3) + stiffness @ compliance
    margin = float(np.linalg.eigvals(inner).real.min(initial=1.0))
    acting, run, steps = wrench, attain(wrench), []
    touches = np.abs(wrench[:, :3]).max(axis=1) > 0.0
    while True:
        step = wrench + respond(run.position - position) - acting
        step[:, :3] = np.linalg.solve(inner, step[:, :3, None])[..., 0]
        missing = np.linalg.norm(np.einsum("nij,nj->ni", compliance, step[:, :3]), axis=1)
        steps.append(float(np.quantile(missing[touches], SHARE, method="higher")) if touches.any() else 0.0)
        if steps[-1] <= EXACT or len(steps) > PASSES or margin <= 0.0:
            return Settled(run, acting, tuple(steps), missing, margin)
        acting = acting + step
        run = attain(acting)
