"""Words of CNC programs: what each one does to a cut from X0 to X10, a line a word; holes drilled in pecks."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.errors import InputError

#: A code, and what is expected of it: the end of the cut [mm], or words of the refusal.
CODES = [
    ("G64 P0.01", (10.0, 0.0)),
    ("G61", (10.0, 0.0)),
    ("G5.2", "NURBS"),
    ("G12", "pocket cycles"),
    ("G777 X5", "may move the tool"),
    ("G4 P1", (10.0, 0.0)),
    ("G4 X1.5", (10.0, 0.0)),
    ("G4 P1 G1 X50 Y20 F600", "two blocks"),
    ("G0 G43.1 Z5", "two blocks"),
    ("TRANS X5", "TRANS is not read and may move"),
    ('CYCLE800(1,"",0,57,5,0,0,0,0,0)', "CYCLE800 is not read and may move"),
    ("TRAORI", "TRAORI is not read and may move"),
]
#: ... and of Sinumerik.
WORDS = [
    ("SOFT", (10.0, 0.0)), ("G777 X5", "may move the tool"), ("TRANS X5", (15.0, 0.0)), ("ROT Z90", (0.0, 10.0)),
    ('CYCLE800(1,"",0,57,5,0,0,0,0,0)', (15.0, 0.0)), ("TRAORI SOFT", (10.0, 0.0)),
    ("G2 X2 Y2 CR=2 F60", (10.0, 0.0)),
]  # fmt: skip


FORMS = {
    ".nc": ("O1 G21 G90 G17\nG0 X0 Y0 Z5\n{}\nG0 X0 Y0 Z1\nG1 X10 F600\nM30\n", CODES),
    ".mpf": ("G71 G90 G17\nG0 X0 Y0 Z5\n{}\nG0 X0 Y0 Z1\nG1 X10 F600\nM30\n", WORDS),
}
CASES = [(suffix, word, expected) for suffix, (_, words) in FORMS.items() for word, expected in words]


@pytest.mark.parametrize(("suffix", "word", "expected"), CASES)
def test_a_word_acts_on_the_cut_after_it(read, suffix: str, word: str, expected: tuple[float, float] | str) -> None:
    text = FORMS[suffix][0].format(word)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected) as refusal:
            read(text, suffix)
        assert refusal.value.where == 3
    else:
        assert np.allclose(read(text, suffix).toolpath.position[-1, :2] * 1e3, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("unit", "depth", "peck", "expected"),
    [("G21", 10.0, 3.333, 3), ("G21", 10.0, 2.5, 4), ("G21", 0.3, 0.1, 3), ("G20", 1.0, 0.3333, 3),
     ("G20", 0.9, 0.3, 3), ("G21", 10.0, 3.0, 4)],
)  # fmt: skip
@pytest.mark.parametrize("cycle", ["G83", "G73"])
def test_a_rounding_remainder_of_a_hole_adds_no_peck(
    read, cycle: str, unit: str, depth: float, peck: float, expected: int
) -> None:
    text = f"{unit} G90\nG0 X0 Y0 Z5\nG98 {cycle} Z-{depth:g} R0 Q{peck:g} F10\nG80\nG0 Z5\nG1 X1\nM30\n"
    path = read(text).toolpath
    height = path.position[:, 2]
    cuts = ~path.rapid & (np.diff(height, prepend=height[0]) < -1e-9)
    assert cuts.sum() == expected
    assert np.isclose(height.min() * 1e3, -depth * (25.4 if unit == "G20" else 1.0), atol=1e-9)
