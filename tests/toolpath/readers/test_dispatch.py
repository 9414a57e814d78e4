"""The text of a CAM file says what language it is in; its suffix decides only where the text leaves it open."""

from __future__ import annotations

from pathlib import Path

import pytest

from compplan.errors import InputError
from compplan.toolpath.readers import READERS, find_reader, read_cam

NC = "%\nO1001 (PART)\nN10 T1 M6\nN20 S800 M3 G90 G21\nN30 G0 X0 Y0 Z5.\nG1 Z0. F100.\nX10.\nM30\n%\n"
APT = "PARTNO BRACKET\nUNITS/MM\nFEDRAT/60,MMPM\nGOTO/0,0,0\nGOTO/10,0,0\nFINI\n"
KRL = "&ACCESS RVP\nDEF part( )\n$VEL.CP=0.05\nPTP {X 0,Y 0,Z 0,A 0,B 180,C 0}\nLIN {X 10}\nEND\n"
RAPID = "MODULE part\nPROC main()\nENDPROC\nENDMODULE\n"
TEXTS = {"gcode": NC, "apt": APT, "krl": KRL, "rapid": RAPID}


@pytest.mark.parametrize("suffix", [".nc", ".ptp", ".tap", ".txt", ".min", ".eia", ".apt", ".src", ".mod", ""])
@pytest.mark.parametrize("language", list(TEXTS))
def test_content_decides_over_the_ending(language: str, suffix: str) -> None:
    reader = find_reader(Path(f"part{suffix}"), TEXTS[language])
    assert reader is not None and reader.name == language


@pytest.mark.parametrize(
    "text",
    ["N10G21G90\n", "/ N10 G0 X1\n", "T1 M6 G90\n", ":12 G90\n", "g0x1\n", "(head)\n\n   G 01 X1\n", "M03 S9 G4 P1\n"],
)
def test_g_code_is_known_by_its_blocks(text: str) -> None:
    assert READERS["gcode"].recognise(text)


@pytest.mark.parametrize("text", ["Dear sir,\nG code follows.\n", "x_mm,y_mm\n1,2\n", "solid G1\n", "", "PAGE 1\n"])
def test_other_texts_are_of_no_known_kind(text: str, tmp_path: Path) -> None:
    (tmp_path / "part.txt").write_text(text)
    with pytest.raises(
        InputError, match=r"part.txt: no CAM language is recognised in this file, nor by its ending '.txt'"
    ):
        read_cam(tmp_path / "part.txt")


@pytest.mark.parametrize("language", list(TEXTS))
def test_a_text_that_nobody_recognises_goes_to_the_reader_of_its_ending(language: str) -> None:
    reader = find_reader(Path(f"part{READERS[language].suffixes[0]}"), "(only a remark)\n")
    assert reader is not None and reader.name == language


def test_the_same_text_gives_the_same_path_under_every_ending(tmp_path: Path) -> None:
    lengths = set()
    for name in ("part.nc", "part.ptp", "part.txt", "part", "part.h", "part.src"):
        (tmp_path / name).write_text(NC)
        lengths.add(read_cam(tmp_path / name).facts.cutting_length_mm)
    assert lengths == {15.0}
