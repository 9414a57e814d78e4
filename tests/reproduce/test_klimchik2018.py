from __future__ import annotations

import pytest

from compplan.reproduce.klimchik2018 import reproduce
from compplan.reproduce.paper import Reproduction
from compplan.robot import load_robot


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return reproduce(load_robot)


def test_the_encoder_table_comes_out_with_the_link_share_as_the_only_free_number(result: Reproduction) -> None:
    """Means of Table 1: 4.03 and 1.81 mm, 44.7 % left (fitted); a model and both encoders leave 19.5 %."""
    fitted = [row.quantity for row in result.rows if row.verdict == "fitted"]
    assert fitted == ["The wall of the links", "Secondary encoders: share of the mean left"]
    assert 3.0 < float(str(result.row(fitted[0]).ours).removesuffix(" mm")) < 8.0
    for row in (f"Table 1: mean with {name} encoders" for name in ("primary", "secondary")):
        assert result.row(row).verdict == "matches"
    model, both = (float(result.row(f"{name}: share of the mean left").ours)
                   for name in ("Stiffness model", "Both encoders combined"))  # fmt: skip
    assert model == pytest.approx(19.5, rel=0.1) and both == pytest.approx(model, rel=0.01)


def test_four_modes_separate_joint_and_link_compliances(result: Reproduction) -> None:
    rows = [row for row in result.rows if row.quantity.startswith("Eqs. 4 to 6")]
    assert [row.verdict for row in rows] == ["matches", "matches"]


def test_joint_one_is_unseen_under_vertical_loads(result: Reproduction) -> None:
    row = result.row("Joint 1 under vertical loads")
    assert row.verdict == "matches" and "joint_1 cannot be determined" in str(row.ours)
