"""How far before a corner each language's programs let the controller leave the path, as they are written.

The figure is what the program says, or what the maker's manual gives for the word that it says; where neither gives one
it is assumed. A zone reaches at most half way to the nearer neighbour. `compplan trace` finds which share of it a
controller uses (`blend_share`).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BlendZone:
    """Hold the zone of a language's corners.

    Args:
        size: Distance from the corner. [m]
        source: Where the figure is from, or "assumed".
        share: Most of it as a share of the shorter neighbour.
        overlap: Time whose way at the feed counts too, in half smoothing times of the controller: where one move slows
            down while the next one speeds up.

    """

    size: float
    source: str
    share: float = 0.5
    overlap: float = 0.0


ZONES = {
    "krl": BlendZone(1e-4, "$APO.CDIS of the program"),
    "rapid": BlendZone(3e-4, "z0 of the RAPID reference manual"),
    "urscript": BlendZone(1e-4, "r of the program", share=0.4),
    "val3": BlendZone(1e-4, "leave and reach of the program"),
    "kawasaki_as": BlendZone(1e-4, "ACCURACY of the program"),
    "fanuc_ls": BlendZone(0.0, "assumed of CNT100: slowing down and speeding up overlap", overlap=1.0),
    "inform": BlendZone(5e-4, "assumed of PL=1"),
    "sinumerik": BlendZone(1e-4, "assumed of G642"),
}
#: Zone of a language that is not listed, such as a post of one's own.
OTHER = BlendZone(1e-4, "assumed")


def widest_zone(languages: tuple[str, ...]) -> BlendZone:
    """Return the zone of the language among some that leaves the path the most at a corner."""
    return max((ZONES.get(name, OTHER) for name in languages), key=lambda zone: (zone.size, zone.overlap))
