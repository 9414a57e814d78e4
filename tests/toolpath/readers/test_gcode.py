from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from cam_files import ends
from commandline import run_command
from hypothesis import given, settings
from hypothesis import strategies as st

from compplan.errors import InputError
from compplan.toolpath.readers import CamTable, read_cam
from compplan.toolpath.reading import read_toolpath

SHIPPED = Path(__file__).parents[3] / "paths" / "jsdc.gcode"


def test_the_shipped_engraving_has_the_facts_that_another_interpreter_found() -> None:
    facts = read_cam(SHIPPED, CamTable(from_mm=[0.0, 0.0, 0.0])).facts
    assert (facts.cutting_moves, facts.rapid_moves, facts.unmoved_blocks, facts.unit) == (2376, 1, 5, "mm")
    assert facts.cutting_length_mm == pytest.approx(661.800463, rel=1e-7)
    assert np.array(facts.box_mm) == pytest.approx(np.array([[0, -58.1149, -1], [102.3526, 0, 1]]))


def test_words_are_modal_and_need_no_spaces(read) -> None:
    cam = read("N10 G21G90\nn20 g0x1y2z3\nG01X4.F60(feed)\nY-.5;end\n\n%\n")
    assert ends(cam) == [[1, 2, 3], [4, 2, 3], [4, -0.5, 3]]
    assert cam.toolpath.feed.tolist() == pytest.approx([0, 1e-3, 1e-3])
    assert cam.toolpath.rapid.tolist() == [True, False, False]


def test_steppers_and_remarks_do_not_end_a_program(read) -> None:
    assert ends(read("G21 G0 X0 Y0 Z0\nG1 X4 F60\nM17\n% LED ON\nX5\n%\nX9\n")) == [[0, 0, 0], [4, 0, 0], [5, 0, 0]]


def test_inches_scale_lengths_and_feeds(read) -> None:
    for words in ("G20", "G70"):
        cam = read(f"{words}\nG0 X0 Y0 Z0\nG1 X1 F60\n")
        assert ends(cam)[-1] == [25.4, 0, 0]
        assert cam.toolpath.feed[-1] == pytest.approx(0.0254)


def test_incremental_moves_count_from_where_the_tool_is(read) -> None:
    assert ends(read("G21 G0 X1 Y1 Z0\nG91 G1 X2 F10\nX2\nG90 X0\n")) == [[1, 1, 0], [3, 1, 0], [5, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("plane", "text", "length"),
    [
        ("G17", "G0 X0 Y20 Z0\nG2 X20 Y0 I0 J-20 F9", 10 * np.pi),
        ("G18", "G0 X0 Y0 Z20\nG2 X20 Z0 I0 K-20 F9", 30 * np.pi),
        ("G18", "G0 X0 Y0 Z20\nG3 X20 Z0 I0 K-20 F9", 10 * np.pi),
        ("G19", "G0 X0 Y0 Z20\nG2 Y20 Z0 J0 K-20 F9", 10 * np.pi),
        ("G17", "G0 X10 Y0 Z0\nG3 I-10 F9", 20 * np.pi),
        ("G17", "G0 X10 Y0 Z0\nG3 X10 Y0 I-10 J0 P2 F9", 40 * np.pi),
        ("G17", "G0 X10 Y0 Z0\nG3 X0 Y10 Z4 I-10 F9", np.hypot(5 * np.pi, 4)),
        ("G17", "G0 X10 Y0 Z0\nG3 X0 Y10 R10 F9", 5 * np.pi),
        ("G17", "G0 X10 Y0 Z0\nG3 X0 Y10 R-10 F9", 15 * np.pi),
        ("G17", "G0 X10 Y0 Z0\nG2 X0 Y10 R10 F9", 5 * np.pi),
    ],
)
def test_arcs_have_their_length_in_every_plane_and_form(read, plane: str, text: str, length: float) -> None:
    cam = read(f"G21 {plane}\n{text}\n")
    assert cam.facts.arcs == 1
    assert cam.facts.cutting_length_mm == pytest.approx(length)
    assert cam.toolpath.cutting_length * 1e3 == pytest.approx(length, rel=1e-4)


@given(
    st.floats(0.5, 200),
    st.floats(-np.pi, np.pi),
    st.floats(0.05, 6.2),
    st.booleans(),
    st.floats(-3, 3),
    st.floats(1e-4, 0.05),
)
@settings(max_examples=60, deadline=None)
def test_chords_keep_to_the_arc_and_hold_its_extremes(
    radius: float, start: float, sweep: float, counter: bool, rise: float, chord: float
) -> None:
    from compplan.toolpath.readers.arcs import arc_about, sample_arc

    sense = 1 if counter else -1
    first = (radius * np.cos(start), radius * np.sin(start), 0.0)
    last = (radius * np.cos(start + sense * sweep), radius * np.sin(start + sense * sweep), rise)
    arc = arc_about(first, last, (0.0, 0.0, 7.0), (0.0, 0.0, 1.0 if counter else -1.0))
    points = np.vstack([first, sample_arc(arc, chord)])
    assert arc.sweep == pytest.approx(sweep)
    assert points[-1] == pytest.approx(last, abs=1e-9)
    assert np.hypot(*points[:, :2].T) == pytest.approx(radius)
    middle = 0.5 * (points[1:] + points[:-1])
    assert radius - np.hypot(*middle[:, :2].T).min() <= chord * (1 + 1e-6)
    dense = start + sense * np.linspace(0, sweep, 20_001)
    assert points[:, 0].max() == pytest.approx(np.max(radius * np.cos(dense)), abs=1e-5)
    assert points[:, 1].min() == pytest.approx(np.min(radius * np.sin(dense)), abs=1e-5)


def test_arc_centres_may_be_absolute_as_the_program_says(read) -> None:
    cam = read("G21 G90.1\nG0 X20 Y0 Z0\nG3 X10 Y10 I10 J0 F9\n")
    assert cam.facts.cutting_length_mm == pytest.approx(5 * np.pi)
    assert not cam.facts.notes


@pytest.mark.parametrize(("centre", "meaning"), [("I10 J0", "absolute"), ("I10 J-0", "absolute"), ("I5 J0", "")])
def test_arc_centres_are_read_as_every_arc_of_the_file_demands(read, centre: str, meaning: str) -> None:
    text = f"G21 G0 X20 Y0 Z0\nG3 X10 Y10 {centre} F9\nX0 Y0 {centre}\n"
    if meaning:
        assert meaning in read(text).facts.notes[0]
    else:
        with pytest.raises(InputError, match=r"part.nc:2: arc starts 5.0000 mm from its centre and ends"):
            read(text)


def test_reversed_arc_centres_are_told(read) -> None:
    text = "G21 G0 X30 Y0 Z0\nG3 X20 Y10 I10 J0 F9\nG2 X30 Y20 I0 J-10\n"
    assert "from the centre to the start" in read(text).facts.notes[0]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("G21 G0 X0 Y0 Z0\nG2 X1 F9", r":2: arc has neither a centre \(I J\) nor a radius \(R\)"),
        ("G21 G18 G0 X0 Y0 Z0\nG2 X1 F9", r":2: arc has neither a centre \(I K\)"),
        ("G21 G0 X0 Y0 Z0\nG2 X10 R2 F9", r":2: arc of radius R 2 mm cannot join ends that are 10 mm apart"),
        ("G1 X#100", r":1: #100 is read before the file has set it"),
        ("G1 X[1+2", r":1: expected '\]' in '\[1\+2'"),
        ("#3000=5", r":1: #3000 belongs to the control"),
        ("O100 SUB", r":1: program control"),
        ("IF R1>5 GOTOF A", r":1: R\[1\] has no value"),
        ("G21\nM98 P100", r":2: subprogram call M98 P100: O100 is not in this file"),
        ("G65 P9000", r":1: subprogram call G65 P9000: O9000 is not in this file"),
        ("G21 G68 R30", r":1: a rotation or scale about the tool's place, whose X is not known"),
        ("G68.2 P2 X0", r":1: G68.2 is read in G90, as Euler angles or with P1"),
        ("G51 X0 Y0 Z0 P1000000", r":1: G51 scales by"),
        ("G21 G91 G16 X1 Y2", r":1: polar coordinates \(G16\) are not read"),
        ("G21 X10 Y5", r":1: coordinates before any motion code"),
        ("G66 P9000", r":1: G66 \(modal macro calls\) is not read"),
        ("G21 G5 X1 Y1 I1 J1 P1 Q1", r":1: word G5 with coordinates"),
        ("G6.2 P3", r":1: G6.2 \(NURBS\)"),
        ("G21 G54 P1\nG0 X0 Y0 Z0\nG1 X5 F9\nG54 P2\nX1", r":5: the file cuts in G54.1 P1 and in G54.1 P2"),
        ("G21 G15 H1\nG0 X0 Y0 Z0\nG1 X5 F9\nG15 H2\nX1", r":5: the file cuts in G54.1 P1 and in G54.1 P2"),
        ("G21 G51.1 X0\nG68 X0 Y0 R90", r":2: G68 under a mirror"),
        ("G21 G51 X0 Y0 Z0 P2.\nG68 X10 Y0 R90", r":2: G68 under a mirror \(G51.1\), or a scale"),
        ("M70\nG91\nM72", r":3: M72 and M73 alone bring back"),
        ("N9 M73", r":1: M72 and M73 alone bring back"),
        ("G71 P1 Q2", r":1: G71 as a lathe cycle"),
        ("G1 X--5 F1", r":1: cannot read 'X--5'"),
    ],
)
def test_what_is_not_read_is_refused_with_its_line(read, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.nc{sentence}"):
        read(text)


def test_a_comment_that_is_never_closed_ends_with_its_line(read) -> None:
    assert ends(read("G21 G0 X0 Y0 Z0 (open\nG1 X1 (a) Y2 F9 ;(b\n"))[-1] == [1, 2, 0]


def test_reading_stops_at_the_end_of_the_program(read) -> None:
    for end in ("M30", "M2", "%"):
        assert read(f"%\nG21 G0 X0 Y0 Z0\nG1 X1 F9\n{end}\nG1 X100\n").facts.cutting_moves == 1


def test_vendor_records_are_read_past_with_a_note(read) -> None:
    cam = read('G21\nMSG("Fräser")\nTRAORI\nG0 X0 Y0 Z0\nG1 X1 F9 M8\nCYCLE832(0.1)\n')
    assert cam.facts.cutting_moves == 1
    assert cam.facts.kind == "sinumerik" and not cam.facts.notes
    assert cam.toolpath.events[0].text == "Fräser"


def test_home_machine_and_probing_moves_are_left_out_with_a_note(read) -> None:
    cam = read("G21 G0 X0 Y0 Z5\nG28 G91 Z0\nG90\nG53 G0 Z0\nG31 Z-10 F5\nG92 Z0\nG1 X1 F9\n")
    assert (cam.facts.cutting_moves, cam.facts.cutting_length_mm) == (1, 1)
    assert {note.split(": ")[1].split(" ")[0] for note in cam.facts.notes} >= {"G28", "G31"}


def test_an_offset_keeps_what_was_cut_and_shifts_what_follows(read) -> None:
    moved = read("G21 G0 X0 Y0 Z0\nG1 X10 F9\nG92 X0\nG1 X10\nG92.1\nG1 X0\n")
    assert [point[0] for point in ends(moved)] == [0, 10, 20, 0]
    shifted = read("G21 G0 X0 Y0 Z0\nG52 X5\nG1 X10 F9\nG52 X0\nX0\n")
    assert [point[0] for point in ends(shifted)] == [0, 15, 0]
    under = read("G21 G0 X0 Y0 Z0\nG52 X5\nG1 X10 F9\nG92 X3\nX4\n")  # stands at 15, calls it 3, goes on by 1
    assert [point[0] for point in ends(under)] == [0, 15, 16]
    before = read("G21 G0 X7 Y0 Z0\nG92 X0\nG1 X10 F9\n")
    assert (before.facts.cutting_length_mm, ends(before)) == (10, [[7, 0, 0], [17, 0, 0]])
    here = read("G21 G92 X7 Y0 Z0\nG1 X10 F9\n")
    assert (here.facts.cutting_length_mm, ends(here)) == (3, [[7, 0, 0], [10, 0, 0]])
    back = read("G21 G0 X7 Y0 Z0\nG92 X0\nG92.2\nG92.3\nG1 X10 F9\n")
    assert ends(back) == [[7, 0, 0], [17, 0, 0]]
    probed = read("G21 G0 X0 Y0 Z5\nG1 X1 F9\nG31 Z-9\nG92 Z0\nG1 X2 Z-1\n")
    assert ends(probed) == [[0, 0, 5], [1, 0, 5], [1, 0, 0], [2, 0, -1]]


def test_an_origin_whose_place_is_not_known_is_asked_for(read) -> None:
    head = "G21 G92 X0 Y0 Z0\nG1 X10 F9\nG92.1\nG0 Y5\n"
    left = read(head)
    assert ends(left) == [[0, 0, 0], [10, 0, 0]] and "left out" in left.facts.notes[-1]
    with pytest.raises(InputError, match="drops the origin that G92 set"):
        read(f"{head}G1 X20\n")
    with pytest.raises(InputError, match=r"G92\.3 brings back"):
        read("G21 G92.3\nG0 X0 Y0 Z0\nG1 X20 F9\n")


def test_feed_modes_give_the_feed_of_the_move(read) -> None:
    start = "G21 G0 X0 Y0 Z0\n"
    assert read(start + "G93 G1 X10 F2").toolpath.feed[-1] == pytest.approx(0.01 * 2 / 60)
    assert read(start + "G95 S600 G1 X10 F0.2").toolpath.feed[-1] == pytest.approx(0.002)
    cam = read(start + "G1 F600 G93 X10 F2\nX20\nG94 X30")  # without an F of its own, and after a change of its meaning
    assert cam.toolpath.feed[2:].tolist() == pytest.approx([0.01 * 2 / 60, 0]) and "G93" in cam.facts.notes[0]
    cam = read(start + "G96 S200 M3\nG95 G1 X10 F.1")
    assert cam.toolpath.feed[-1] == 0 and "S with G96" in cam.facts.notes[0]
    cam = read(start + "G1 X10")
    assert cam.toolpath.feed[-1] == 0 and "cutting moves before any feed F have none" in cam.facts.notes[0]


def test_drilling_cycles_are_skipped_or_cut(read) -> None:
    text = "G21 G0 X0 Y0 Z5\nG99 G81 X10 Y0 Z-5 R2 F60\nG91 X10 L2\nG80\nG90 G1 X0 F60\n"
    skipped, cut = read(text, cycles="skip"), read(text)
    assert (skipped.facts.cycles, skipped.facts.cutting_moves) == (3, 1)
    assert "drilling cycle G81 is left out" in skipped.facts.notes[0]
    assert [point for point, rapid in zip(ends(cut), cut.toolpath.rapid, strict=True) if not rapid] == [
        [10, 0, -5], [20, 0, -5], [30, 0, -5], [0, 0, 2],
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "axis"), [("head", [0.5, 0, np.sqrt(0.75)]), ("table", [0.5, 0, np.sqrt(0.75)])])
def test_rotary_words_turn_the_tool_axis_by_a_stated_convention(read, kind: str, axis: list[float]) -> None:
    angles = "A30 C90" if kind == "head" else "A-30 C-90"
    cam = read(f"G21\nG43.4 H1\nG0 X0 Y0 Z0 A0 C0\nG1 X10 {angles} F60\n", rotary=kind)
    assert cam.toolpath.axis[-1] == pytest.approx(axis)
    assert cam.facts.cutting_moves == 1 and cam.facts.cutting_length_mm == pytest.approx(10)
    turns = np.degrees(np.arccos(np.clip(np.sum(cam.toolpath.axis[1:] * cam.toolpath.axis[:-1], axis=1), -1, 1)))
    assert turns.max() < 2.1
    assert read(f"G21 G0 X0 Y0 Z0 A0\nG1 X10 {angles} F60\n", rotary="ignore").toolpath.axis[-1].tolist() == [0, 0, 1]


def test_rotary_words_without_a_stated_machine_are_refused(read) -> None:
    for text in ("G21 G0 X0 Y0 Z0\nG1 X1 B10 F9\n", "G21 G43.4 H1\nG0 X0 Y0 Z5 A30 C45\nG1 Z0 F9\n"):
        with pytest.raises(InputError, match=r'rotary words .* state which with rotary = "head", "table" or'):
            read(text)
    assert read("G21 G0 X0 Y0 Z0 A0 C0\nG1 X1 C0 F9\n").facts.cutting_moves == 1  # they turn nothing


def test_a_compensated_contour_asks_what_the_file_holds(read) -> None:
    head = "G21 G90 G17\nG0 X0 Y0 Z5\nG1 Z0 F100\n"
    with pytest.raises(InputError, match=r":4: G41 compensates the radius of the cutter. If the file"):
        read(f"{head}G41 D1 X10\n")
    cam = read(f"{head}G41 D1 X10\nY10\nG40 X0\n", compensation="centre_line")
    assert ends(cam)[-3:] == [[10, 0, 0], [10, 10, 0], [0, 10, 0]]
    assert cam.facts.notes == (
        "line 4: G41 compensates wear alone: the path is that of the tool's centre, as compensation = centre_line says",
    )
    assert read(f"{head}G41 D0 X10\n").facts.notes == ()


def test_long_programs_take_time_in_proportion(read) -> None:
    times = []
    for count in (2_000, 16_000):
        blocks = (f"N{i} G1 X{i * 0.1:.3f} Y{i % 7} F100\nG3 X{i * 0.1 + 1:.3f} I0.5 J0" for i in range(count // 2))
        text = "\n".join(["G21 G0 X0 Y0 Z0", *blocks])
        start = time.process_time()
        read(text)
        times.append(time.process_time() - start)
    assert times[1] < 8 * 3 * times[0]


def test_convert_writes_the_table_and_prints_the_facts(tmp_path: Path, monkeypatch, capsys) -> None:
    out = tmp_path / "path.csv"
    words = ["convert", SHIPPED, "--out", out, "--from", "0,0,0"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0 and "cutting moves   2376, 661.800 mm" in done.out
    assert read_toolpath(out).cutting_length == pytest.approx(0.6618, rel=1e-4)
    done = run_command([*words, "--max-step-mm", "0.1", "--json"], monkeypatch, capsys)
    facts = json.loads(done.out)
    assert done.status == 0 and facts["cutting_moves"] == 2376 and facts["waypoints"] == len(read_toolpath(out)) > 6000
