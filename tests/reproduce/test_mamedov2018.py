from __future__ import annotations

import numpy as np
import pytest

from compplan.reproduce.mamedov2018 import (
    TABLE_3,
    compensated_share,
    identify_reduced,
    map_full,
    reduced_gap,
    with_material,
    with_wall,
)
from compplan.reproduce.mamedov_circles import compensate_circles
from compplan.robot import load_robot

FULL, PAPER = load_robot("kuka_kr270_full"), load_robot("kuka_kr270")


def test_six_springs_of_the_full_model_are_those_of_table_3_within_17_per_cent() -> None:
    found = identify_reduced(FULL)
    assert found.estimate.free.all()
    np.testing.assert_allclose(found.compliance * 1e6, TABLE_3, rtol=0.17)


def test_lever_and_weight_of_rotations_move_joint_one_by_5_per_cent_at_most() -> None:
    stated = identify_reduced(FULL).compliance[0]
    others = [identify_reduced(FULL, lever=lever, rotation_weight=weight).compliance[0]
              for lever, weight in ((0.1, 1.0), (3.0, 1.0), (0.3, 0.3), (0.3, 3.0))]  # fmt: skip
    np.testing.assert_allclose(others, stated, rtol=0.05)
    assert np.ptp(others) > 0.01 * stated


def test_joint_six_cannot_be_told_under_a_pure_force_through_its_axis() -> None:
    found = identify_reduced(FULL, lever=0.0)
    assert [item.held for item in found.estimate.held] == ["joint_6"]
    assert "passes through its axis" in found.estimate.held[0].sentence
    assert found.compliance[5] == 0.0


def test_steel_fits_table_3_worst_and_the_folder_holds_aluminium() -> None:
    gaps = {young: np.abs(identify_reduced(with_material(FULL, young)).compliance * 1e6 / TABLE_3 - 1).max()
            for young in (45e9, 70e9, 210e9)}  # fmt: skip
    assert gaps[45e9] < gaps[70e9] < gaps[210e9]
    for a, b in zip(with_material(FULL, 70e9).link_elasticities, FULL.link_elasticities, strict=True):
        np.testing.assert_allclose(a.compliance, b.compliance, rtol=1e-3, atol=1e-16)


def test_the_papers_springs_compensate_more_than_80_per_cent_of_the_maps() -> None:
    planes = map_full(FULL, 30)
    own = identify_reduced(FULL).robot
    for plane in planes.values():
        table, fitted = compensated_share(FULL, PAPER, plane), compensated_share(FULL, own, plane)
        assert 0.80 < table.mean() < 0.92
        assert np.nanmax(reduced_gap(FULL, PAPER, plane)) == pytest.approx(0.9e-6, rel=0.1)
        assert fitted.mean() > table.mean() and fitted.mean() > 0.95


def test_thicker_walls_leave_less_to_the_links() -> None:
    thin, thick = (identify_reduced(with_wall(FULL, wall)).compliance for wall in (0.01, 0.05))
    joints = np.array([spring.compliance for spring in FULL.springs])
    assert ((thin - joints)[:3] > (thick - joints)[:3]).all()


def test_a_posture_exists_that_meets_the_twelve_means_of_the_circles_within_a_third() -> None:
    errors = compensate_circles(FULL, PAPER)
    before, after = errors.misfit()
    assert np.abs(errors.misfit()).max() < 1 / 3
    assert np.abs(before).max() < 0.1 and np.abs(after[0]).max() < 0.15
    assert (errors.means(errors.after).sum(axis=1) < 0.2 * errors.means(errors.before).sum(axis=1)).all()
