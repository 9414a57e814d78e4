"""What tests of several files share."""

from __future__ import annotations

import os
from collections.abc import Iterator

# small matrices are slower on several threads, and what is read once when numpy is imported cannot be set later
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest

from compplan.planning import plan as planning

# processes that tests start keep what Python compiled, as users' processes do
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="module")
def graph_alone() -> Iterator[None]:
    """Leave postures as the graph finds them (tests/planning/test_candidates.py asks what follows)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "better_start", lambda start, asked, **named: start)
        yield
