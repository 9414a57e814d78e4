"""Tables and charts of pages state what their heads say: shares of a square, turns a minute, root mean squares."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from compplan.reporting import error_band_section as promise_section
from compplan.reporting import forces_page, learn_page, posture_section
from compplan.uncertainty.band import PARTS


def test_shares_of_the_square_of_a_band_add_up_to_one() -> None:
    sizes = {name: (3.0, 4.0)[k] if k < 2 else 0.0 for k, name in enumerate(PARTS)}
    promise = SimpleNamespace(
        cut=np.ones(5, bool), widest=2, radius=np.full(5, 5e-3), between=0.0, whole=6e-3, without={},
        parts={name: np.full(5, 1e-3 * size) for name, size in sizes.items()},
    )  # fmt: skip
    rows = promise_section._table(promise).rows  # type: ignore[arg-type]
    assert [row[3] for row in rows[:2]] == ["36\u00a0%", "64\u00a0%"]
    assert [row[2] for row in rows[:2]] == pytest.approx([3.0, 4.0])


def test_costs_that_only_the_chosen_posture_has_stand_beside_a_dash() -> None:
    """The time of the run is worked out for the posture that the program found, not for the plain one."""
    plain = {"sensitivity_rms_mm": 0.2, "travel_error_rms_mm": 0.0, "inertia_rms_mm": 0.0, "joint_travel_deg": 90.0}
    stance = SimpleNamespace(spin=np.zeros(3), changes=(), instead_of=None)
    table = posture_section._list_costs(stance, ({**plain, "driven_s": 3.0}, plain))  # type: ignore[arg-type]
    (row,) = (row for row in table.rows if str(row[1]).startswith("3"))
    assert row[2] == "\u2013"


def test_the_section_that_is_swept_is_drawn_in_square_millimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = {}
    monkeypatch.setattr(forces_page, "_colour_path", lambda found, value, unit: drawn.update({unit: value}))
    found = SimpleNamespace(wrench=np.array([[3.0, 4.0, 0.0, 9, 9, 9]]), engagement=SimpleNamespace(section=5e-6))
    forces_page._overview(found)  # type: ignore[arg-type]
    assert drawn["N"] == pytest.approx([5.0]) and drawn["mm²"] == pytest.approx(5.0)


def test_what_a_part_teaches_is_stated_as_root_mean_squares_in_mm() -> None:
    part = 1e-3 * np.array([[1.0, 0.0, 0.0], [0.0, 7.0, 0.0]])
    lesson = SimpleNamespace(rms=5e-3, physics=part, pushed=2 * part, residual=0 * part, held_out=1e-3)
    rows = learn_page._explain(SimpleNamespace(lesson=lesson)).rows  # type: ignore[arg-type]
    assert [row[1] for row in rows[:4]] == pytest.approx([5.0, 5.0, 10.0, 0.0])
