"""What a shop has to measure with."""

from __future__ import annotations

from dataclasses import dataclass

#: Instruments: positions from anywhere, a ball put into sockets, dial gauges.
TRACKER, SOCKETS, GAUGE = "tracker", "sockets", "gauge"


@dataclass(frozen=True)
class Equipment:
    """What a shop has to measure poses with; defaults are assumed."""

    weights: tuple[float, ...] = (0.0,)  #: Weights that can hang at the tool, 0 for none. [kg]
    pull: float = 0.0  #: Force with which the tool can be pulled sideways, 0 for none. [N]
    sigma: float = 3e-5  #: Standard deviation of the instrument per axis. [m]
    #: Frames that are unknown, of "base" and "tool"; None: both of a tracker, none of other instruments.
    register: tuple[str, ...] | None = None
    seed: int = 0  #: Seed of the candidates.
    instrument: str = TRACKER  #: What sees the tip: TRACKER, SOCKETS or GAUGE.
    places: int | None = None  #: Unknown places at which it stands; None: the usual number.
    length: float = 0.0  #: Distance of the two sockets of a plate, 0 for single ones. [m]

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the frames that are unknown: the poses have to tell them from the arm."""
        if self.register is None:
            return ("base", "tool") if self.instrument == TRACKER else ()
        return tuple(part for part in self.register if part != "base" or self.instrument == TRACKER)

    @property
    def loaded(self) -> bool:
        """Tell whether loads can be changed."""
        return self.pull > 0.0 or any(self.weights)
