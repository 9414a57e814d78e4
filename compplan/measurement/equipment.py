"""Measuring equipment of a workshop."""

from __future__ import annotations

from dataclasses import dataclass

#: Instruments: tracker (positions), a ball in sockets, dial gauges.
TRACKER, SOCKETS, GAUGE = "tracker", "sockets", "gauge"


@dataclass(frozen=True)
class Equipment:
    """Equipment for measuring poses; defaults are assumed."""

    weights: tuple[float, ...] = (0.0,)  #: Masses that can hang at the tool, 0 for none. [kg]
    pull: float = 0.0  #: Force with which the tool can be pulled sideways, 0 for none. [N]
    sigma: float = 3e-5  #: Standard deviation of the instrument per axis. [m]
    #: Unknown frames, of "base" and "tool"; None: both for a tracker, none for other instruments.
    register: tuple[str, ...] | None = None
    seed: int = 0  #: Seed of the candidates.
    instrument: str = TRACKER  #: TRACKER, SOCKETS or GAUGE.
    places: int | None = None  #: Number of places of the instrument, with unknown positions; None: default number.
    length: float = 0.0  #: Distance of the two sockets of a plate, 0 for single ones. [m]

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the unknown frames, which the poses have to determine in addition to the arm."""
        if self.register is None:
            return ("base", "tool") if self.instrument == TRACKER else ()
        return tuple(part for part in self.register if part != "base" or self.instrument == TRACKER)

    @property
    def loaded(self) -> bool:
        """Return whether poses can be measured under load."""
        return self.pull > 0.0 or any(self.weights)
