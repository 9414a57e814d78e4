"""Sums of a signal times many waves, as products of two short lists, are the sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.diagnosis.evidence.proposals import _match_waves, _Spectrum, wave_grid


@pytest.mark.parametrize(("spread", "slides"), [(6.0, False), (0.5, False), (1.3, True)])
def test_sums_over_the_grid_are_those_of_every_wave(spread: float, slides: bool) -> None:
    rng = np.random.default_rng(1)
    angle, signal = rng.uniform(-spread, spread, 40), rng.normal(size=40)
    spectrum = _Spectrum(angle, spread, slides)
    assert spectrum.grid == pytest.approx(np.unique(np.concatenate(wave_grid(spread, slides))), abs=0.0)
    phase = np.outer(spectrum.grid, angle) * (2 * np.pi if slides else 1.0)
    assert spectrum.sums(signal) == pytest.approx(np.exp(1j * phase) @ signal, abs=1e-10)
    assert spectrum.double_sums(signal) == pytest.approx(np.exp(2j * phase) @ signal, abs=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_the_wave_that_is_picked_explains_most_by_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, weight = rng.uniform(0.0, 1.2, 40), rng.uniform(0.5, 2.0, 40)
    spectrum = _Spectrum(angle, float(np.ptp(angle)), False)
    pull = weight * 9.0 * np.sin(rng.choice(spectrum.grid[20:40]) * angle + rng.uniform(0, 6.3)) + rng.normal(size=40)
    line = np.column_stack([np.ones(40), angle])
    left = pull - weight * (line @ np.linalg.solve(line.T @ (weight[:, None] * line), line.T @ pull))
    gains = []
    for rate in spectrum.grid:
        wave = np.column_stack([np.sin(rate * angle), np.cos(rate * angle)])
        gram = wave.T @ (weight[:, None] * wave) + 1e-9 * weight.sum() * np.eye(2)
        gains.append(left @ wave @ np.linalg.solve(gram, wave.T @ left))
    picked = _match_waves(angle, pull, weight, spectrum, False, 1)
    assert gains[int(np.argmin(np.abs(spectrum.grid - picked[0])))] > 0.99 * max(gains)
