"""Instruments of the virtual shop of `benchmarks.shop`: what gauges and bars read of the true robot."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks import shop

HEAD = [*(f"q{k}_deg" for k in range(1, 7)), *shop.LOAD, "contact"]


def fill(folder: Path, monkeypatch: pytest.MonkeyPatch, column: str, more: dict[str, str]) -> tuple[np.ndarray, ...]:
    """Fill in a log of four poses with steady hands and no noise; return readings [m] and true tips, (4, 3) [m]."""
    for name in ("HAND", "LEAN", "TRACKER", "REPEATABILITY", "TARGET"):
        monkeypatch.setattr(shop, name, 0.0)
    with (folder / "campaign.csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, [*HEAD, *more, column])
        writer.writeheader()
        for turn in range(4):
            q = [5.0 * turn, -10.0 + 3.0 * turn, 40.0, 15.0, 30.0 - 4.0 * turn, 0.0]
            row = dict(zip(HEAD, [*map(str, q), *["0"] * 6, "1"], strict=True)) | more
            writer.writerows([row, row])
    drawn = shop.draw_shop(shop.ROOT / "robots" / "abb_irb6640_185_280", 1)
    assert shop.fill_log(drawn, folder / "campaign.csv", folder / "log.csv") == 4
    rows, q, wrench = shop.read_rows(folder / "log.csv")
    assert not any(row[column] for row in rows[::2])
    tip, _ = shop.move(drawn, q, wrench, path=False)
    return np.array([1e-3 * float(row[column]) for row in rows[1::2]]), tip[1::2]


def test_a_gauge_reads_how_far_the_true_tip_went_along_it_from_the_first_pose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, tip = fill(tmp_path, monkeypatch, "reading_mm", {"dir_i": "0", "dir_j": "0.6", "dir_k": "0.8"})
    assert reading[0] == 0.0 and np.ptp(reading) > 1e-3
    np.testing.assert_allclose(reading, (tip - tip[0]) @ [0.0, 0.6, 0.8], atol=1e-8)


def test_a_bar_reads_how_far_the_true_tip_is_from_a_centre_300_mm_away_below(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = np.array([[1, 0, 2], [-1, 1, 2], [0, -2, 1], [2, 1, 1], [0, 0, 1]], float)
    centre = np.array([1.4, 0.3, 0.5])
    tips = centre + shop.BAR * away / np.linalg.norm(away, axis=1)[:, None]
    np.testing.assert_allclose(shop._find_centre(tips), centre, atol=1e-6)
    monkeypatch.setattr(shop, "_find_centre", lambda tip: centre)
    reading, tip = fill(tmp_path, monkeypatch, "distance_mm", {})
    np.testing.assert_allclose(reading, np.linalg.norm(tip - centre, axis=1), atol=1e-8)
