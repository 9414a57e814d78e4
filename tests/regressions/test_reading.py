"""Programs that were read wrongly without a word: they are refused with a line and a remedy, or read rightly."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import pytest
from commandline import Answer, run_command

Patch, Capture = pytest.MonkeyPatch, pytest.CaptureFixture[str]
Row = tuple[float, float, float, bool]


class Reader:
    """Write CAM files into a folder and convert them on the command line."""

    def __init__(self, folder: Path, monkeypatch: Patch, capsys: Capture) -> None:
        self.folder, self.monkeypatch, self.capsys = folder, monkeypatch, capsys

    def run(self, command: str, text: str, ending: str, *options: str) -> Answer:
        """Run `compplan convert` or `post` on a text."""
        file = self.folder / f"a{ending}"
        file.write_text(text)
        return run_command((command, file, *options), self.monkeypatch, self.capsys)

    def refuse(self, text: str, ending: str, *options: str) -> str:
        """Return the one line that refuses a text; nothing may be written."""
        out = self.folder / "refused.csv"
        answer = self.run("convert", text, ending, "--out", str(out), *options)
        assert (answer.status, answer.out, out.exists()) == (2, "", False)
        assert answer.err.startswith("error: ")
        assert answer.err.count("\n") == 1
        return answer.err

    def read(self, text: str, ending: str, *options: str) -> tuple[list[dict[str, float]], list[str]]:
        """Return the rows of the toolpath, in mm and mm/s, and the notes."""
        out = self.folder / "read.csv"
        answer = self.run("convert", text, ending, "--out", str(out), "--json", *options)
        assert answer.status == 0, answer.err
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(out.open())]
        return rows, json.loads(answer.out)["notes"]

    def follow(self, text: str, ending: str, *options: str) -> list[Row]:
        """Return where the tool goes, and whether it goes there rapidly."""
        rows, _ = self.read(text, ending, *options)
        return [(row["x_mm"], row["y_mm"], row["z_mm"], row["rapid"] == 1.0) for row in rows]


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> Reader:
    return Reader(tmp_path, monkeypatch, capsys)


HOME = "G21 G90 G54\n{home}\nG90\nG1 X50 Y50 F1000\nG1 Z-5 F100\nX100\nG28 G91 Z0\nM30\n"
KRL = """DEF A()
$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}
{first}
$VEL.CP=0.02
LIN {{X 10,Y 0,Z -5,A 0,B 90,C 0}}
LIN {{X 60,Y 0,Z -5,A 0,B 90,C 0}}
END
"""
RAPID = """MODULE A
CONST robtarget p1:=[[10,0,-5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget p2:=[[60,0,-5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PROC main()
MoveAbsJ [[0,0,0,0,90,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v100,fine,tool0;
MoveL p1,v20,fine,tool0;
MoveL p2,v20,fine,tool0;
ENDPROC
ENDMODULE
"""
UNKNOWN_STARTS = {
    "G28": (HOME.format(home="G28 G91 Z0"), ".nc", 4, "X Y Z"),
    "G30": (HOME.format(home="G30 G91 Z0"), ".nc", 4, "X Y Z"),
    "G53": (HOME.format(home="G53 G0 Z0"), ".nc", 4, "X Y Z"),
    "only Z unknown": (HOME.format(home="G0 X0 Y0 Z20\nG28 G91 Z0"), ".nc", 5, "Z"),
    "an axis made known by a feed move": ("G21 G90\nG0 X0 Y0 Z5\nG28 G91 Z0\nG90 G1 X5 Y5 Z-5 F100\n", ".nc", 4, "Z"),
    "arc": ("G21 G90\nG0 X0 Y0 Z5\nG53 Z0\nG2 X10 I5 F100\n", ".nc", 4, "Z"),
    "Heidenhain": ("BEGIN PGM A MM\nL Z+20 FMAX\nL X+10 F200\nL X+60\nEND PGM A MM\n", ".h", 3, "X Y"),
    "Heidenhain M91": (
        "BEGIN PGM A MM\nL X+0 Y+0 Z+20 FMAX\nL Z-1 FMAX M91\nL X+9 Z-5 F200\nEND PGM A MM\n", ".h", 4, "Z"
    ),
    "Sinumerik": ("G71 G90\nG0 Z20\nG1 X10 F200\nX60\nM30\n", ".mpf", 3, "X Y"),
    "Sinumerik SUPA": ("G71 G90\nG0 X0 Y0 Z20\nSUPA G0 Z0 D0\nG1 X10 Z-5 F200\nM30\n", ".mpf", 4, "Z"),
    "KRL": (KRL.format(first="PTP {A1 0,A2 -90,A3 90,A4 0,A5 90,A6 0}"), ".src", 5, "X Y Z"),
    "KRL without any": (KRL.format(first="WAIT SEC 0"), ".src", 5, "X Y Z"),
    "RAPID": (RAPID, ".mod", 6, "X Y Z"),
    "APT": ("UNITS/MM\nFEDRAT/100,MMPM\nGOTO/10,0,-5\nGOTO/60,0,-5\nFINI\n", ".apt", 3, "X Y Z"),
    "APT GOHOME": (
        "UNITS/MM\nRAPID\nGOTO/0,0,5\nFEDRAT/100,MMPM\nGOTO/0,0,1\nGOHOME\nGOTO/9,0,1\nFINI\n", ".apt", 7, "X Y Z"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", UNKNOWN_STARTS)
def test_no_cut_begins_where_the_tool_is_not_known(name: str, reader: Reader) -> None:
    text, ending, line, axes = UNKNOWN_STARTS[name]
    said = reader.refuse(text, ending)
    assert f":{line}: a cut begins where {axes} of the tool is not known" in said
    assert "--from X,Y,Z" in said


def test_a_g_code_file_that_begins_with_a_cut_starts_at_zero_and_says_so(reader: Reader) -> None:
    text = "G21 G90\nG1 X50 Y50 Z-5 F1000\nX100\n"
    rows, notes = reader.read(text, ".nc")
    assert [rows[0][key] for key in ("x_mm", "y_mm", "z_mm")] == [0.0, 0.0, 0.0]
    assert any("0 is assumed" in note for note in notes)


@pytest.mark.parametrize("name", [name for name in UNKNOWN_STARTS if name != "APT GOHOME"])
def test_a_stated_start_is_where_such_a_cut_begins(name: str, reader: Reader) -> None:
    text, ending, _, _ = UNKNOWN_STARTS[name]
    way = reader.follow(text, ending, "--from=-7,-8,120")
    first = next(index for index, row in enumerate(way) if not row[3])
    start = way[first - 1]
    assert all(
        value == stated for value, stated, axis in zip(start, (-7.0, -8.0, 120.0), "XYZ", strict=False)
        if axis in UNKNOWN_STARTS[name][3]
    )  # fmt: skip
    assert [row[2] for row in way if row[3] and row[2] < 0.0] == []


def test_post_refuses_such_a_program_and_takes_the_start(reader: Reader) -> None:
    text = HOME.format(home="G28 G91 Z0")
    out = reader.folder / "o"
    options = ("--robot", "kuka_kr240", "--part", "1800,0,700", "--program", "krl", "--out", str(out))
    answer = reader.run("post", text, ".nc", *options)
    assert (answer.status, out.exists()) == (2, False)
    assert "a.nc:4: a cut begins where X Y Z of the tool is not known" in answer.err
    answer = reader.run("post", text, ".nc", *options, "--from", "0,0,100")
    assert (answer.status, (out / "plan.json").exists()) == (0, True), answer.err


def test_a_start_is_three_numbers(reader: Reader) -> None:
    answer = reader.run("convert", "G21\nG0 X0 Y0 Z1\n", ".nc", "--out", str(reader.folder / "o.csv"), "--from", "1,2")
    assert (answer.status, answer.err) == (2, "error: --from is '1,2', expected X,Y,Z in mm\n")


def test_a_rapid_move_to_a_place_makes_it_known(reader: Reader) -> None:
    way = reader.follow("G21 G90 G54\nG28 G91 Z0\nG90\nG0 X50 Y50\nG0 Z10\nG1 Z-5 F100\nX100\n", ".nc")
    assert way == [(50.0, 50.0, 10.0, True), (50.0, 50.0, -5.0, False), (100.0, 50.0, -5.0, False)]


def test_travel_of_a_printer_leads_to_the_first_known_place(reader: Reader) -> None:
    head = "M104 S200\nG28\nG92 E0\nG1 Z2 F3000\nG1 X10 Y20 F5000\n"
    way = reader.follow(f"{head}G1 X60 E5 F1000\n", ".gcode")
    assert way == [(10.0, 20.0, 2.0, True), (60.0, 20.0, 2.0, False)]
    said = reader.refuse(f"{head}G1 X60 E5 F1000\nG28 X\nG1 X9 E6\n", ".gcode")
    assert ":8: a cut begins where X Y Z of the tool is not known" in said


@pytest.mark.parametrize("line", [
    "o1 while [#1 lt 3]", "o1 if [#1 gt 3]", "o1 else", "o1 endif", "o1 repeat [3]", "N5 o1 do", "o<cut> call",
    "o1 break", "o100 sub", "o1 endwhile", "o[#1] call",
])  # fmt: skip
def test_words_of_the_flow_are_never_passed_over(line: str, reader: Reader) -> None:
    said = reader.refuse(f"G21 G90\n#1=0\nG0 X0 Y0 Z5\n{line}\nG1 X9 F100\n", ".ngc")
    assert "a.ngc:4: program control" in said


def test_e_moves_nothing_outside_of_printers(reader: Reader) -> None:
    text = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-5 F100\nX40\n{}\nM30\n"
    said = reader.refuse(text.format("E0 X0 Y245"), ".nc")
    assert ":5: word E0 is read in files of printers only" in said
    assert ":5: word E0 " in reader.refuse(text.format("E0"), ".nc")


@pytest.mark.parametrize("line", ["G0 H0 Z0", "H0 Z0", "G0 G49 Z0"])
def test_z_without_the_length_of_the_tool_is_no_place_in_the_part(line: str, reader: Reader) -> None:
    way = reader.follow(f"G21 G90\nG0 X0 Y0 Z5\nG1 Z-5 F100\nX40\nG0 Z-4\n{line}\nM30\n", ".nc")
    assert way[-1] == (40.0, 0.0, 5.0, True)
    said = reader.refuse(f"G21 G90\nG0 X0 Y0 Z5\nG1 Z-5 F100\nX40\nG1 {line.removeprefix('G0')}\nM30\n", ".nc")
    assert ":5: a cut to Z without tool length compensation" in said


@pytest.mark.parametrize(("code", "unit", "feed"), [
    ("G70", (), 600.0), ("G700", (), 600.0 * 25.4), ("G71", (), 600.0), ("G710", (), 600.0),
    ("G70", ("--unit", "inch"), 600.0 * 25.4),
])  # fmt: skip
def test_g70_of_sinumerik_scales_lengths_alone(code: str, unit: tuple[str, ...], feed: float, reader: Reader) -> None:
    rows, _ = reader.read(f"{code} G90\nG0 X0 Y0 Z1\nG1 X2 F600\nM30\n", ".mpf", *unit)
    assert rows[-1]["x_mm"] == pytest.approx(2.0 * (25.4 if code in ("G70", "G700") else 1.0))
    assert rows[-1]["feed_mm_s"] == pytest.approx(feed / 60.0)


def test_points_of_two_machine_coordinate_systems_are_not_joined(reader: Reader) -> None:
    head = "TOOL PATH/A,TOOL,M\nMSYS/0,0,0,1,0,0,0,1,0\nFEDRAT/MMPM,100\nRAPID\nGOTO/0,0,9\nGOTO/0,0,1\n{}GOTO/9,0,1\n"
    said = reader.refuse(head.format("MSYS/100.0,0,0,1,0,0,0,1,0\n"), ".cls")
    assert ":7: MSYS changes within the file" in said
    assert len(reader.follow(head.format("MSYS/0.0,0.0,0.0,1.,0.,0.,0.,1.,0.\n"), ".cls")) == 3


@pytest.mark.parametrize("line", ["X50000", "G1 X0 Y-12000 F100", "G3 X10 Y0 I20000 J0", "Z010000"])
def test_numbers_that_may_count_in_increments_are_asked_for_a_point(line: str, reader: Reader) -> None:
    said = reader.refuse(f"G21 G90\nG0 X0 Y0 Z5\nG1 X1 F100\n{line}\n", ".nc")
    assert ":4: " in said
    assert "has no decimal point" in said


def test_lengths_without_a_point_and_of_the_size_of_a_part_count_in_the_unit(reader: Reader) -> None:
    way = reader.follow("G21 G90\nG0 X0 Y0 Z5\nG1 X50 F100\nX9000\nX50000.\n", ".nc")
    assert [row[0] for row in way] == [0.0, 50.0, 9000.0, 50000.0]
    assert ":3: " in reader.refuse("G20 G90\nG0 X0 Y0 Z5\nG1 X20000 F100\n", ".nc")


@pytest.mark.parametrize(("call", "times"), [("M98 P1 K3", 3), ("M98 P1 L2", 2), ("M98 P20001", 2), ("M98 P1", 1)])
def test_calls_are_repeated_as_often_as_they_say(call: str, times: int, reader: Reader) -> None:
    way = reader.follow(f"O7\nG21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\n{call}\nM30\nO1\nG91 G1 X10\nG90\nM99\n", ".nc")
    assert [row[0] for row in way] == [0.0, 0.0, *(10.0 * (i + 1) for i in range(times))]


@pytest.mark.parametrize("line", ["G2 X0 Y0 I5 Z-4 L2", "G1 G91 X5 L3", "G0 G91 X5 L2"])
def test_repeats_and_turns_by_l_are_refused(line: str, reader: Reader) -> None:
    said = reader.refuse(f"G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F100\n{line}\nM30\n", ".nc")
    assert ":4: L" in said
    assert "is not read" in said


def test_turns_of_an_arc_by_p_are_cut(reader: Reader) -> None:
    rows, _ = reader.read("G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F100\nG2 X0 Y0 I5 Z-4 P2\n", ".nc")
    assert sum(a["x_mm"] < 9.99 <= b["x_mm"] for a, b in pairwise(rows)) == 2


@pytest.mark.parametrize(("text", "ending", "line"), [
    ("G90 G54\nG0 X0 Y0 Z1\nG1 X2 F60\nM30\n", ".nc", 2),
    ("G90 G54\nG0 X0 Y0 Z1\nG1 X2 F60\nM30\n", ".mpf", 2),
    ("RAPID\nGOTO/0,0,5\nFEDRAT/100\nGOTO/0,0,1\n", ".apt", 2),
    ("1 TOOL CALL 1 Z S100\n2 L X+0 Y+0 Z+5 FMAX\n3 L X+2 F60\n", ".h", 1),
])  # fmt: skip
def test_a_file_without_a_unit_is_asked_for_it(text: str, ending: str, line: int, reader: Reader) -> None:
    said = reader.refuse(text, ending)
    assert f":{line}: no unit of length is stated" in said
    assert "--unit mm or --unit inch" in said
    small, inch = (max(abs(r[0]) + abs(r[2]) for r in reader.follow(text, ending, "--unit", u)) for u in ("mm", "inch"))
    assert inch == pytest.approx(25.4 * small)


@pytest.mark.parametrize(("text", "ending", "line"), [
    ("G90\nG0 X0 Y0 Z0\nCYCLE81(5,0,1,-10)\nM30\n", ".mpf", 3), ("G90\nTRANS X10\nG0 X0 Y0 Z0\nM30\n", ".mpf", 2),
    ("G90\nG0 X0 Y0 Z0\nG81 R2 Z-5 F100\nM30\n", ".nc", 3), ("FROM/0,0,9\nFEDRAT/9,IPM\nGOTO/0,0,1\n", ".apt", 2),
])  # fmt: skip
def test_lengths_of_cycles_and_frames_have_a_unit(text: str, ending: str, line: int, reader: Reader) -> None:
    said = reader.refuse(text, ending)
    assert f":{line}: " in said
    assert "--unit" in said


def test_holes_begin_at_places_that_the_program_states(reader: Reader) -> None:
    home = "G21 G90\nG0 X0 Y0{}\nG28 G91 Z0\nG90\n"
    way = reader.follow(f"{home.format('')}G81 X9 R2 Z-5 F100\nX20\nG80\nM30\n", ".nc")
    assert way == [
        (0.0, 0.0, 2.0, True), (9.0, 0.0, 2.0, True), (9.0, 0.0, -5.0, False), (9.0, 0.0, 2.0, True),
        (20.0, 0.0, 2.0, True), (20.0, 0.0, -5.0, False), (20.0, 0.0, 2.0, True),
    ]  # fmt: skip
    said = reader.refuse(f"{home.format('')}G81 X9 Z-5 F100\nM30\n", ".nc")
    assert ":5: a drilling cycle begins where the height of the tool is not known" in said
    said = reader.refuse("G21 G90\nG0 X0 Z9\nG81 X9 R2 Z-5 F100\nM30\n", ".nc")
    assert "Y of the tool is not known; write Y into it" in said


def test_a_unit_after_lengths_comes_too_late(reader: Reader) -> None:
    assert ":2: no unit of length" in reader.refuse("G90\nG0 X1 Y0 Z5\nG21\nG1 X9 F100\n", ".nc")


def test_the_job_and_post_take_a_unit(reader: Reader) -> None:
    options = ("--robot", "kuka_kr240", "--part", "1800,0,700", "--program", "krl", "--out", str(reader.folder / "o"))
    answer = reader.run("post", "G0 X0 Y0 Z5\nG1 X2 F600\n", ".nc", *options)
    assert (answer.status, "no unit of length is stated" in answer.err) == (2, True)
    cam = reader.folder / "cam.toml"
    cam.write_text('unit = "inch"\nfrom_mm = [1.0, 2.0, 3.0]\n')
    assert reader.follow("G1 X2 F600\n", ".nc", "--cam", str(cam))[-1] == (50.8, 2.0, 3.0, False)


def test_printers_count_in_millimetres(reader: Reader) -> None:
    assert reader.follow("M140 S60\nG0 X10 Y20 Z2\nG1 X60 E5 F1000\n", ".gcode")[-1] == (60.0, 20.0, 2.0, False)


def test_rapid_moves_in_another_offset_are_not_dropped_in_silence(reader: Reader) -> None:
    text = "G21 G90 G54\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX40\nG0 Z5\nG59\nG0 X0 Y245 Z9\nM30\n"
    rows, notes = reader.read(text, ".nc")
    assert [row["x_mm"] for row in rows] == [0.0, 0.0, 40.0, 40.0]
    assert "line 7: rapid moves in G59 are left out: how it lies to G54 is not known" in notes


HEIDENHAIN = """{head}BEGIN PGM A MM
{tool}
TOOL CALL 1 Z S1500
FLUTE LEN 32.0 FLUTE EXT 60.0
L M03
CYCLE DEF 9.0 DWELL TIME
CYCLE DEF 9.1 5
L X+0 Y+0 Z+25 FMAX
L Z-1 F1000. S6000
L X+40 (TO THE END)
{cycle} DEF 200 DRILLING ~
Q200=2 ~
Q201=-3 ~
Q206=100 ~
Q203=0 ~
Q204=10
L X+60 FMAX M99
END PGM A MM
"""


@pytest.mark.parametrize("head", ["", '($Message("load the settings") )\n'])
@pytest.mark.parametrize("tool", ["TOOL DEF1 L+30,000 F300", "TOOL DEF 1 L+30 R+4"])
@pytest.mark.parametrize("cycle", ["CYCL", "CYCLE"])
def test_harmless_spellings_of_heidenhain_programs(head: str, tool: str, cycle: str, reader: Reader) -> None:
    rows, _ = reader.read(HEIDENHAIN.format(head=head, tool=tool, cycle=cycle), ".h")
    way = [(row["x_mm"], row["z_mm"], round(60.0 * row["feed_mm_s"])) for row in rows]
    assert way[:3] == [(0.0, 25.0, 0), (0.0, -1.0, 1000), (40.0, -1.0, 1000)]
    assert min(way, key=lambda row: row[1]) == (60.0, -3.0, 100)


def test_a_program_of_an_old_control_is_read(reader: Reader) -> None:
    text = ("(FIRST LINE)\nBEGIN PGM  MM\nTOOL DEF1 L+30,000 F300\nTOOL CALL 1 Z S 1500,000\nL Z+5.000 R0 F9999 M13\n"
            "L X+20.000 Y+20.0000\nL Z-2 F100\nL IX+10\nEND PGM\n")  # fmt: skip
    assert reader.follow(text, ".h") == [
        (20.0, 20.0, 5.0, True), (20.0, 20.0, -2.0, False), (30.0, 20.0, -2.0, False)
    ]  # fmt: skip
