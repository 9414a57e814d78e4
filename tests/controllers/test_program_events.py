"""Spindle, coolant, tools, dwells and stops reach the programs of every language in their order and at their place."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run_command
from golden_cell import write_job

from compplan.controllers.readback.poses import Move
from compplan.controllers.writers import Program, Wiring, describe_program, write_program
from compplan.errors import InputError
from compplan.toolpath.events import Event
from tests.controllers.test_golden_programs import FORMS, make_program, read_form

EVENT_FORMS = [form for form in FORMS if not form.startswith("csv")]
#: What happens around the two waypoints: before the first, between them, after the last.
EVENTS = (
    Event(-1, "comment", 0.0, "roughing"), Event(-1, "tool", 7.0), Event(-1, "spindle_cw", 9000.0),
    Event(0, "coolant"), Event(0, "dwell", 1.5), Event(0, "optional_stop"), Event(1, "coolant_off"),
    Event(1, "spindle_off"), Event(1, "output", 1.0, "$OUT[9]"), Event(1, "stop"),
)  # fmt: skip
WIRED = Wiring(spindle=3, spindle_ready=5, coolant=4, tool_change="CHANGER", signals={"$OUT[9]": 8})
#: The same, worked out by hand; "move" is a waypoint.
DONE = [("call", 7.0), ("on", 3.0), ("expect", 5.0), "move", ("on", 4.0), ("wait", 1.5),
        ("pause",), "move", ("off", 4.0), ("off", 3.0), ("on", 8.0), ("pause",)]  # fmt: skip
ASKED = [("pause",), "move", ("wait", 1.5), ("pause",), "move", ("pause",)]
NATIVE = [("call", 7.0), ("cw", 9000.0), "move", ("flood",), ("wait", 1.5), ("m1",), "move", ("dry",),
          ("stop",), ("on", 8.0), ("pause",)]  # fmt: skip
NATIVE_ASKED = [("pause",), ("cw", 9000.0), "move", ("flood",), ("wait", 1.5), ("m1",), "move", ("dry",),
                ("stop",), ("pause",), ("pause",)]  # fmt: skip


def make_events(folder: Path, language: str, wiring: Wiring) -> Program:
    return replace(make_program(folder, language), events=EVENTS, wiring=wiring)


#: Lines of each language that do it, written by hand from the manuals; "|" parts lines.
LINES: dict[str, dict[str, str]] = {
    "krl": {"pause": 'MsgNotify("")|HALT',
            "on": "$OUT[{:g}]=TRUE", "off": "$OUT[{:g}]=FALSE", "wait": "WAIT SEC {:.3f}",
            "expect": "WAIT FOR $IN[{:g}]", "call": "CHANGER({:g})"},
    "rapid": {"pause": 'TPWrite "";|Stop;',
              "on": "SetDO do{:g},1;", "off": "SetDO do{:g},0;", "wait": "WaitTime {:.3f};",
              "expect": "WaitDI di{:g},1;", "call": "CHANGER {:g};"},
    "urscript": {"pause": 'popup("", title="", blocking=True)', "on": "set_standard_digital_out({:g}, True)",

                 "off": "set_standard_digital_out({:g}, False)", "wait": "sleep({:.3f})", "call": "CHANGER({:g})",
                 "expect": "while (not get_standard_digital_in({:g})):|sync()|end"},
    "inform": {"pause": "PAUSE", "on": "DOUT OT#({:g}) ON",
               "off": "DOUT OT#({:g}) OFF", "wait": "TIMER T={:.2f}", "expect": "WAIT IN#({:g})=ON",
               "call": "CALL JOB:CHANGER"},
    "kawasaki_as": {"pause": 'TYPE ""|PAUSE',
                    "on": "SIGNAL {:g}", "off": "SIGNAL -{:g}", "wait": "TWAIT {:.3f}", "expect": "SWAIT 100{:g}",
                    "call": "CALL changer({:g})"},
    "fanuc_ls": {"pause": "PAUSE", "on": "DO[{:g}]=ON",
                 "off": "DO[{:g}]=OFF", "wait": "WAIT    {:.2f}(sec)", "expect": "WAIT DI[{:g}]=ON",
                 "call": "CALL CHANGER({:g})"},
    "val3": {"pause": 'userPage()|putln("")|l_nKey=get()', "on": "doOut{:g}=true", "off": "doOut{:g}=false",
             "wait": "delay({:.3f})",
             "expect": "wait(diIn{:g}==true)", "call": "call CHANGER({:g})"},
    "sinumerik": {"pause": "M0", "m1": "M1", "wait": "G4 F{:.3f}", "cw": "M3 S{:g}", "stop": "M5",
                  "flood": "M8", "dry": "M9", "on": "$A_OUT[{:g}]=1", "call": "CHANGER({:g})"},
}  # fmt: skip


def list_lines(language: str, steps: list[Any]) -> list[str]:
    written = [step if step == "move" else LINES[language][step[0]].format(*step[1:]) for step in steps]
    return [line for text in written for line in text.split("|")]


def list_actions(moves: list[Move]) -> list[str]:
    return [move.action if move.kind == "act" else "move" for move in moves]


@pytest.mark.parametrize("form", EVENT_FORMS)
@pytest.mark.parametrize("wired", [True, False])
def test_what_happens_beside_motion_happens_in_order_in_every_language(form: str, wired: bool, tmp_path: Path) -> None:
    language = form.split()[0]
    program = make_events(tmp_path / "cell", language, WIRED if wired else Wiring())
    write_program(program, language, tmp_path / "out")
    moves = read_form(form, tmp_path / "out", "two")
    wanted = [[ASKED, DONE], [NATIVE_ASKED, NATIVE]][language == "sinumerik"][wired]
    assert list_actions(moves) == list_lines(language, wanted)
    assert all(move.stops for move in moves)


@pytest.mark.parametrize("form", EVENT_FORMS)
def test_comments_stand_at_their_place(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    events = (Event(0, "comment", 0.0, "finishing pass"),)
    program = replace(make_program(tmp_path / "cell", language), events=events)
    write_program(program, language, tmp_path / "out")
    texts = [path.read_text() for path in sorted((tmp_path / "out").rglob("*")) if path.is_file()]
    held = [text for text in texts if "finishing pass" in text]
    assert len(held) == (1 if language == "sinumerik" else 2)
    assert len(read_form(form, tmp_path / "out", "two")) == 2
    assert not read_form(form, tmp_path / "out", "two")[0].stops  # a comment does not stop the tool


@pytest.mark.parametrize("form", EVENT_FORMS)
def test_events_stay_between_their_waypoints_when_programs_are_cut_up(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    two = make_program(tmp_path / "cell", language)
    rows = np.repeat([0, 1], 3)
    many = {name: getattr(two, name)[rows] for name in ("joints", "feed", "rapid", "tcp", "status", "bent")
            if getattr(two, name) is not None}  # fmt: skip
    words = {key: values[rows] for key, values in two.words.items()}
    native = {key: values[rows] for key, values in two.native.items()}
    events = tuple(Event(row, "dwell", row + 1.0) for row in (0, 2, 3, 4, 5))
    program = replace(two, **many, words=words, native=native, time=np.arange(6.0), events=events)
    write_program(program, language, tmp_path / "out", most=2)
    done = list_actions(read_form(form, tmp_path / "out", "two"))
    steps = ["move", ("wait", 1.0), "move", "move", ("wait", 3.0), "move", ("wait", 4.0), "move",
             ("wait", 5.0), "move", ("wait", 6.0)]  # fmt: skip
    assert done == list_lines(language, steps)


def test_signals_may_have_names_where_the_language_names_them(tmp_path: Path) -> None:
    wiring = WIRED.model_copy(update={"spindle": "doMill", "spindle_ready": "diSpeed"})
    for language in ("rapid", "val3"):
        write_program(make_events(tmp_path / language, language, wiring), language, tmp_path / "out")
    assert "SetDO doMill,1;\n    WaitDI diSpeed,1;" in (tmp_path / "out" / "two_1.mod").read_text()
    assert "doMill=true" in (tmp_path / "out" / "two" / "part1.pgx").read_text()
    data = (tmp_path / "out" / "two" / "two.dtx").read_text()
    assert re.findall(r'name="(\w+)" access="public" xsi:type="array" type="dio"', data) == [
        "doMill", "doOut4", "doOut8", "diSpeed",
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"output.io spindle is 'doMill', KRL numbers its signals; give a number"):
        write_program(make_events(tmp_path / "krl", "krl", wiring), "krl", tmp_path / "bad")
    assert not (tmp_path / "bad").exists()


def test_what_is_not_wired_is_told(tmp_path: Path) -> None:
    notes = describe_program(make_events(tmp_path / "a", "krl", Wiring()), "krl")
    assert any("stops for 6 events and asks the operator (tool, spindle cw, optional stop, " in note for note in notes)
    assert any("coolant is a comment only" in note for note in notes)
    told = describe_program(make_events(tmp_path / "b", "krl", WIRED.model_copy(update={"spindle_ready": None})), "krl")
    assert any("waits 5 s for the spindle (assumed)" in note for note in told)
    remarks = replace(make_events(tmp_path / "d", "krl", Wiring()), events=(Event(0, "comment", 0.0, "roughing"),))
    assert not any("asks the operator" in note for note in describe_program(remarks, "krl"))
    (table,) = describe_program(make_events(tmp_path / "c", "csv", WIRED), "csv")
    assert table == "csv: spindle, coolant, dwells and stops of the CAM file are not in this table"


def test_a_job_wires_the_cell_and_the_plan_keeps_the_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cut of the golden cell as APT: the spindle starts above the part and stops above it."""
    job = write_job(tmp_path, "krl")
    (tmp_path / "cut.apt").write_text(
        "PARTNO PLATE\nUNITS/MM\nMULTAX\nRAPID\nGOTO/0,80,0,.1,1,-.2\nSPINDL/9000,CLW\nFEDRAT/750,MMPM\n"
        "GOTO/0,0,0,.1,1,-.2\nDELAY/2\nPPRINT/HALF\nGOTO/10,2,0,.1,1,-.15\nRAPID\nGOTO/30,80,15,.1,1,-.1\nSPINDL/OFF\nFINI\n"
    )
    job.write_text(job.read_text().replace("path.csv", "cut.apt") + "io = { spindle = 3 }\n")
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    moves = read_form("krl linear", tmp_path / "out", "golden")
    steps = [move.action if move.kind == "act" else move.kind for move in moves]
    short = [step for before, step in zip([None, *steps], steps, strict=False) if step != before]
    on, off = "$OUT[3]=TRUE", "$OUT[3]=FALSE"
    assert short == ["joint", on, "WAIT SEC 5.000", "line", "WAIT SEC 2.000", "line", "joint", off]
    turning = False
    for move in moves:
        turning = turning if move.kind != "act" else {on: True, off: False}.get(move.action, turning)
        assert turning or move.kind != "line"
    notes = json.loads((tmp_path / "out" / "plan.json").read_text())["notes"]
    assert any("spindle speeds are comments" in note for note in notes)
    text = (tmp_path / "out" / "golden_L1.src").read_text()
    order = [text.index(part) for part in (";FOLD PARTNO PLATE", "$OUT[3]=TRUE", "WAIT SEC 2", ";FOLD HALF")]
    assert order == sorted(order)


def test_an_odd_signal_is_refused_with_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for value in ("true", '"a b"', "-1", '"x;HALT"'):
        job = write_job(tmp_path / value.strip('"').replace(";", ""), "krl")
        job.write_text(job.read_text() + f"io = {{ spindle = {value} }}\n")
        answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
        assert answer.status == 2 and "output.io.spindle: is" in answer.err and not (tmp_path / "out").exists()
