"""What the doctor finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Remark:
    """One thing that was looked at.

    Attributes:
        state: "fine": as it should be; "note": worth knowing; "odd": likely a mistake, or it will limit results.
        about: What was looked at, in a word or two.
        sentence: What was seen, with its figure.
        advice: What to do about it; "" where there is nothing to do.

    """

    state: Literal["fine", "note", "odd"]
    about: str
    sentence: str
    advice: str = ""
