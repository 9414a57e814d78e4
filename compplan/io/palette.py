"""Colours of every picture, on pages and in plots."""

from __future__ import annotations

#: Colours legible on light and on dark backgrounds.
BEFORE = "#d1603d"
AFTER = "#2b86a8"
BAND = "#6c60c0"
TOLERANCE = "#737b85"
LIMIT = "#c2382e"
NEUTRAL = "#8b929b"
#: Colours of categories, distinguishable with colour blindness; further categories take the next dash.
CATEGORIES = ("#2b86a8", "#d1603d", "#6c60c0", "#78606c", "#c08478")
DASHES = ("solid", "dash", "dot")
