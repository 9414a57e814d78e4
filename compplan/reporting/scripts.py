"""The scripts that lie in a page, and the policy that lets no other run."""

from __future__ import annotations

import base64
import gzip
import hashlib
from functools import cache
from pathlib import Path

#: The part of plotly.js that pages draw with; how it was made stands beside it.
PLOTLY = Path(__file__).parent / "plotly" / "plotly.min.js.gz"


def write_policy(script: str, *, with_charts: bool) -> str:
    """Return the content security policy of a page: its own script and the chart library by their hashes, no network.

    Args:
        script: The script of the page.
        with_charts: Whether the chart library lies in the page.
    """
    digests = [hash_script(script.encode())] + ([_plotly_digest()] if with_charts else [])
    rules = {
        "default-src": "'none'", "script-src": " ".join(digests), "style-src": "'unsafe-inline'",
        "img-src": "data: blob:", "base-uri": "'none'", "form-action": "'none'",
    }  # fmt: skip
    return "; ".join(f"{rule} {value}" for rule, value in rules.items())


def hash_script(text: bytes) -> str:
    """Return the source expression of an inline script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text).digest()).decode()}'"


@cache
def _plotly_digest() -> str:
    return hash_script(gzip.decompress(PLOTLY.read_bytes()))


@cache
def load_plotly() -> str:
    """Return the chart library, packed, as text."""
    return base64.b64encode(PLOTLY.read_bytes()).decode("ascii")


def pack_text(text: str) -> str:
    """Return a text as the script of a page unpacks it: gzip in base64."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")
