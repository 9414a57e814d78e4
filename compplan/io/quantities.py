"""Formatting of quantities and lists: significant digits, a suitable unit, no misleading zero."""

from __future__ import annotations

import math
from collections.abc import Sequence


def format_number(value: float, digits: int = 3) -> str:
    """Format a number with significant digits and separated thousands.

    Args:
        value: The number; NaN becomes a dash.
        digits: Significant digits; integers keep all digits.
    """
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if magnitude < -5 or magnitude > 8:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    text = f"{value:,.{max(digits - 1 - magnitude, 0)}f}".replace(",", "\u202f")
    return text.replace("-", "−")


def shorten(value: float) -> float:
    """Round a number to the six significant digits that result files hold."""
    return float(f"{value:.6g}")


def format_set_value(value: float) -> str:
    """Format an input value, such as a tolerance, as short as it was given."""
    return f"{value:.6g}".replace("-", "−")


def format_set_length(metres: float) -> str:
    """Format an input length in mm, as short as it was given."""
    return f"{format_set_value(1e3 * metres)}\u00a0mm"


def format_length(metres: float) -> str:
    """Format a measured or computed length [m] with three digits: um below 0.1 mm, mm otherwise."""
    if math.isnan(metres):
        return "–"
    if 0 < abs(metres) < 1e-8:
        return "below 0.01\u00a0µm"
    if abs(metres) < 1e-4:
        return f"{format_number(metres * 1e6)}\u00a0µm"
    return f"{format_number(metres * 1e3)}\u00a0mm"


def format_mm(metres: float) -> str:
    """Format a length in mm with micrometres as the last digits.

    Args:
        metres: The length. [m]
    """
    if 0 < abs(metres) < 1e-6:
        return "<\u00a00.001\u00a0mm"
    coarse = math.isnan(metres) or abs(metres) >= 0.1e-3
    return f"{format_number(1e3 * metres) if coarse else f'{1e3 * metres:.3f}'}\u00a0mm"


def format_mm_change(before: float, after: float) -> str:
    """Format a change from one length to another in mm. [m]"""
    return f"{format_mm(before).removesuffix(chr(160) + 'mm')} → {format_mm(after)}"


def state_mm(metres: float) -> str:
    """Format a length in mm with three digits, in ASCII, for messages and programs."""
    return f"{float(f'{1e3 * metres:.3g}'):g} mm"


def format_percent(share: float) -> str:
    """Format a share in percent; only exact 0 and 1 read as 0 and 100."""
    if math.isnan(share):
        return "–"
    if 0 < share < 1e-4:
        return "below 0.01\u00a0%"
    if 0.999 < share < 1:
        return "above 99.9\u00a0%"
    return f"{format_set_value(float(f'{100 * share:.3g}'))}\u00a0%"


def join_names(names: Sequence[str]) -> str:
    """Join names with commas and "and"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def name_length(metres: float) -> str:
    """Format a round length for an axis: 1e-6 is "1 µm", 0.2 is "200 mm"."""
    for unit, size in (("nm", 1e-9), ("µm", 1e-6)):
        if metres < 999 * size:
            return f"{metres / size:.6g}\u00a0{unit}"
    return f"{metres * 1e3:.6g}\u00a0mm"
