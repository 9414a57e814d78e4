"""G-code that may not be read wrong without a word: text, numbers, frames, votes, bounds, headers, corners."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.job.job import check_job
from compplan.toolpath.readers import CamFile, CamTable, read_cam
from compplan.toolpath.reading import read_toolpath

HEAD = "G21 G0 X0 Y0 Z0\n"


def length(cam: CamFile) -> float:
    return cam.facts.cutting_length_mm


@pytest.mark.parametrize("break_", ["\x85", "\u2028", "\u2029", "\x0c", "\x0b", "\x1c", "\x1e"])
@pytest.mark.parametrize("form", ["(first {} X99)\nG1 X1 F9\n", "; first {} G1 X99 F9\nG1 X1 F9\n"])
def test_only_cr_and_lf_end_a_line(read, break_: str, form: str) -> None:
    assert length(read(HEAD + form.format(break_))) == 1


def test_a_file_in_latin_1_with_byte_85_in_a_comment_keeps_its_comment(tmp_path: Path) -> None:
    (tmp_path / "p.nc").write_bytes(HEAD.encode() + b"(erster \x85 X99 f\xfcr)\r\nG1 X1 F9\r\n")
    assert length(read_cam(tmp_path / "p.nc")) == 1


def test_exponents_are_read_or_refused_and_never_dropped(read) -> None:
    assert read(HEAD + "G1 X1.5E-05 Y2E+1 F9\n").toolpath.position[-1].tolist() == pytest.approx([1.5e-8, 0.02, 0])
    with pytest.raises(InputError, match=r"part.nc:2: number 'G1 X1.5E5 F9' may be read in two ways"):
        read(HEAD + "G1 X1.5E5 F9\n")


@pytest.mark.parametrize(
    ("block", "sentence"),
    [
        ("G1 X1 X2 F9", "word X stands twice"),
        ("G0 G1 X1 F9", "G0 and G1 stand in one block"),
        ("G1 X Y5 F9", "cannot read 'X'"),
        ("G1 X10,5 F9", "cannot read ',5'"),
        ("G1 X1 R2 F9", "R2 in a straight move is not read"),
        ('T="MILL X10', r"a quote \(\"\) is opened and never closed"),
        ("(a (b) X5", "cannot read"),
        ("G123 X5", "G123 with coordinates is not read"),
        ("G70 I5 J0 L4", "lathe cycle or bolt circle"),
        ("G10 L2 P0 X5", "changes the active work offset"),
        ("L100 P3", "subprogram call L100 is not read"),
        ("G1 X5 ,A45", "cannot read ',A45'"),
    ],
)
def test_doubtful_blocks_are_refused(read, block: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.nc:2: .*{sentence}"):
        read(f"{HEAD}{block}\nG1 X1 F9\n")


GEOMETRY = [
    "BSPLINE", "SCALE X2 Y3", "PLANE SPATIAL SPA+10", "REPEATB L1", "TRANSMIT", "G68.3 X1",
    "G66 P1",
]  # fmt: skip


@pytest.mark.parametrize("head", ["G92 S500 (Y5)", "G96 S200 M3", "T0101", "G50 S2000"])
def test_turning_programs_are_refused(read, head: str) -> None:
    turned = f"G21\n{head}\nG0 X50. Z2.\nG1 Z-20. F.2\n"
    with pytest.raises(InputError, match=r"part.nc:2: a turning program \(no Y\) is not read"):
        read(turned)
    assert length(read(turned.replace("Z2.", "Y0 Z2."))) == 22


@pytest.mark.parametrize("word", GEOMETRY)
def test_words_that_change_geometry_or_frames_are_refused(read, word: str) -> None:
    with pytest.raises(InputError, match=r"part.nc:2: .*is not read"):
        read(f"{HEAD}{word}\nG1 X10 F9\n")


@pytest.mark.parametrize("word", ["CYCLE800()", "ROT", "MIRROR", "PLANE RESET STAY", "CYCLE832(0.1)", "FFWON SOFT"])
def test_resets_and_harmless_words_are_read_past(read, word: str) -> None:
    assert length(read(f"{HEAD}{word}\nG1 X10 F9\n")) == 10


def test_words_after_a_harmless_one_are_read(read) -> None:
    assert length(read(HEAD + "TRAORI G1 X5 F9\nG1 X7 SPOS=90\n")) == 7


def test_programmed_shifts_of_siemens_move_what_follows(read) -> None:
    text = HEAD + "G1 X10 F9\nTRANS X100\nX10\nATRANS X5 Y1\nX10\nTRANS\nX0 Y0\n"
    x = (read(text).toolpath.position[:, 0] * 1e3).round(9).tolist()
    assert x == [0, 10, 110, 115, 0]


def test_text_in_quotes_is_no_coordinate(read) -> None:
    assert length(read(HEAD + 'N10 T="MILL X10" M6\nG1 X1 F9\n')) == 1


def test_full_circles_have_no_vote_and_one_bad_arc_no_majority(read) -> None:
    circles = "G2 I5 F9\nI6\nI7\n"
    absolute = "G3 X10 Y10 I10 J0\n"  # from (20, 0) about (10, 0), if absolute
    with pytest.raises(InputError, match=r":6: arc starts 10.0000 mm from its centre and ends 22.3607"):
        read("G21 G0 X20 Y0 Z0\n" + circles + "G0 X20\n" + absolute)
    with pytest.raises(InputError, match=r":3: arc starts"):
        read("G21 G0 X20 Y0 Z0\nF9\n" + absolute)
    with pytest.raises(InputError, match=r":3: arc starts"):
        read("G21 G0 X20 Y0 Z0\nF9\n" + absolute + "G0 X20 Y0\n" + absolute)
    two = read("G21 G0 X20 Y0 Z0\nF9\n" + absolute + "G3 X0 Y0 I10 J0\n")
    assert length(two) == pytest.approx(10 * np.pi) and "absolute" in two.facts.notes[0]


def test_work_offsets_that_the_program_states_move_the_path(read) -> None:
    known = "G10 L2 P1 X0 Y0 Z0\nG10 L2 P2 X100 Y0 Z50\n" + HEAD + "G1 X10 F9\nG55 X10 Z-50\n"
    cam = read(known)
    assert cam.toolpath.position[-1].tolist() == pytest.approx([0.11, 0, 0]) and not cam.facts.notes
    with pytest.raises(InputError, match=r"part.nc:5: the file cuts in G54 and in G55, .* state which one .* G10 L2"):
        read(HEAD + "G1 X10 F9\nG10 L2 P2 X100\nG55\nG1 X20\n")


@pytest.mark.parametrize(
    ("block", "sentence"),
    [
        ("G2 I5 Z-1 P1000000 F9", r"arc of P1e\+06 turns, expected a whole number from 1 to 10000"),
        ("G2 I500 Z-1 P9999 F9", "more than 2000000 waypoints"),
        ("G91 G81 X1 Z-1 R1 L3000000 F9", "cycle with 3000000 repeats, at most 10000"),
        ("G2 X10 R1000000000000. F9", r"arc of radius 1e\+12 mm, at most 1e\+06 mm"),
        ("G1 X1000000000. F9", r"coordinate 1e\+09 mm"),
        ("G1 X1" + "0" * 20_000, "line of 20005 characters, at most 10000"),
    ],
)
def test_one_line_cannot_take_the_machine_down(read, block: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.nc:[23]: {sentence}"):
        read(f"{HEAD}G1 X0 Y1 F9\n{block}\n", cycles="expand")


def test_files_that_are_no_programs_are_refused_at_once(tmp_path: Path) -> None:
    file = tmp_path / "big.nc"
    with file.open("wb") as handle:
        handle.truncate(2**30)
    with pytest.raises(InputError, match="holds 1024 MB, CAM files of at most 128 MB"):
        read_cam(file)
    file.write_bytes(b"\n" * 3_000_001)
    with pytest.raises(InputError, match="has 3000001 lines, at most 3000000"):
        read_cam(file)


@pytest.mark.parametrize(
    "header",
    ["%_N_NAME_MPF\n;$PATH=/_N_WKS_DIR/_N_NAME_WPD\n", "%123\n", "%\nO1000 (NAME)\n", "<NAME>\n", ":1000\n",
     "O<NAME>\n", "[HEADER]\n*** {customer} ***\nProgram name: X99!\n"],
)  # fmt: skip
def test_headers_of_every_control_are_read(read, header: str) -> None:
    assert length(read(header + HEAD + "G1 X1 F9\n")) == 1


def test_skip_marks_may_stand_anywhere_in_a_line(read) -> None:
    cam = read(HEAD + "N10 /G1 X1 F9\nG1 X2 / Y5\n/2 Y7\n")
    assert length(cam) == pytest.approx(1 + np.hypot(1, 5) + 2)
    assert "blocks marked with / are read (3 times)" in cam.facts.notes[0]


def test_siemens_subprograms_are_read_from_the_file_or_from_beside_it(read, tmp_path: Path) -> None:
    main = "%_N_MAIN_MPF\n" + HEAD + "G1 X10 F9\n{}\nM30\n"
    within = main.format("L100 P3") + "%_N_L100_SPF\nG91\nG1 Y5\nG90\nM17\n"
    assert length(read(within, ".mpf")) == 25
    (tmp_path / "KONTUR.SPF").write_text("G1 X12\nRET\nG1 X99\n")
    assert length(read(main.format("KONTUR"), ".mpf")) == 12
    with pytest.raises(InputError, match=r":4: word TASCHE is not read and may move the tool"):
        read(main.format("TASCHE"), ".mpf")
    (tmp_path / "ROUND.SPF").write_text("ROUND\n")
    with pytest.raises(InputError, match=r"ROUND.SPF:1: subprogram ROUND is called 1 times at depth 12"):
        read(main.format("ROUND"), ".mpf")


@pytest.mark.parametrize(
    ("corner", "expected"),
    [(",R2", 16 + np.pi), (", R2", 16 + np.pi), (",C2", 16 + np.sqrt(8)), ("RND=2", 16 + np.pi),
     ("CHR=2", 16 + np.sqrt(8)), ("CHF=2", 20 - 2 * np.sqrt(2) + 2)],
)  # fmt: skip
def test_corners_are_rounded_or_cut_off_as_asked(read, corner: str, expected: float) -> None:
    cam = read(f"{HEAD}G1 X10 F9 {corner}\nY10\n")
    assert length(cam) == pytest.approx(expected)
    x, y = (cam.toolpath.position[:, :2] * 1e3).T
    assert x.max() == pytest.approx(10) and (x[-1], y[-1]) == pytest.approx((10, 10))
    assert not np.any(np.hypot(x - 10, y) < 0.8)  # the corner itself is not cut


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("G1 X10 F9 ,R20\nY10\n", ":3: corner of line 2: a corner of 20 takes 20 of moves of 10"),
        ("G1 X10 F9 ,R2\nG0 Y10\n", ":3: the rounded or cut corner of line 2 has no cutting move"),
        ("G1 X10 F9 ,R2\nX0\n", ":3: corner of line 2: the path turns back"),
        ("G1 X10 F9 ,R2\n", ":2: the rounded or cut corner of line 2 has no cutting move after it"),
    ],
)
def test_corners_that_cannot_be_cut_are_refused(read, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read(HEAD + text)


def test_a_file_without_cuts_says_so(tmp_path: Path) -> None:
    file = tmp_path / "holes.nc"
    file.write_text("G21\nG0 X0 Y0 Z5\nG81 X1 Z-1 R1 F9\nX2\nM30\n")
    with pytest.raises(InputError, match="drilling only, 2 holes and no other cut; the option cycles = expand"):
        read_toolpath(file, cam=CamTable(cycles="skip"))
    assert read_toolpath(file).cutting_length == pytest.approx(4e-3)
    file.write_text("G21\nG0 X0 Y0 Z5\nM30\n")
    with pytest.raises(InputError, match="nothing to cut"):
        read_toolpath(file)


def test_notes_stay_with_the_toolpath_and_strict_refuses_them(read, tmp_path: Path) -> None:
    read("G21 M77\nG0 X0 Y0 Z0\nG1 X1 F9\n")
    note = "part.nc, line 1: M77 is unknown: programs have it as a comment; if it switches something, add it."
    assert read_toolpath(tmp_path / "part.nc").notes == (note,)
    with pytest.raises(InputError, match=r"part.nc: 1 notes, strict allows none; the first: line 1: M77 is"):
        read_toolpath(tmp_path / "part.nc", cam=CamTable(strict=True))


def test_a_plan_tells_what_its_reader_noted(tmp_path: Path) -> None:
    from compplan.planning.plan import plan_job

    (tmp_path / "part.nc").write_text("G21 M77\nG0 X0 Y0 Z0\nG41\nG1 X20 F600\n")
    data = {
        "schema": 1, "robot": "staubli_tx200", "toolpath": "part.nc", "plan": {"strategy": "mirror"},
        "part": {"position_mm": [1500.0, 0.0, 183.0]}, "process": {"model": "constant", "force_N": [0.0, 0.0, 100.0]},
        "sampling": {"max_step_mm": 10.0}, "cam": {"compensation": "centre_line"},
    }  # fmt: skip
    notes = json.loads(json.dumps(plan_job(check_job(data, tmp_path / "job.toml")).to_dict()["notes"]))
    assert [note for note in notes if note.startswith("part.nc, line")] == [
        "part.nc, line 1: M77 is unknown: programs have it as a comment; if it switches something, add it.",
        "part.nc, line 3: G41 compensates wear alone: the path is that of the tool's centre, as compensation = "
        "centre_line says.",
    ]
