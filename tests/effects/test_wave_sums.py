"""Sums of a signal times many waves, as products of two short lists, are the sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.diagnosis.evidence.proposals import _Spectrum, wave_grid


@pytest.mark.parametrize(("spread", "slides"), [(6.0, False), (0.5, False), (1.3, True)])
def test_sums_over_the_grid_are_those_of_every_wave(spread: float, slides: bool) -> None:
    rng = np.random.default_rng(1)
    angle, signal = rng.uniform(-spread, spread, 40), rng.normal(size=40)
    spectrum = _Spectrum(angle, spread, slides)
    assert spectrum.grid == pytest.approx(np.unique(np.concatenate(wave_grid(spread, slides))), abs=0.0)
    phase = np.outer(spectrum.grid, angle) * (2 * np.pi if slides else 1.0)
    assert spectrum.sums(signal) == pytest.approx(np.exp(1j * phase) @ signal, abs=1e-10)
    assert spectrum.double_sums(signal) == pytest.approx(np.exp(2j * phase) @ signal, abs=1e-10)
