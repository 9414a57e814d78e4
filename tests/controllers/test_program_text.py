"""Words of a job, a robot or a file name never become robot code, in any language."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest
from commandline import run_command
from golden_cell import write_job

from compplan.controllers.writers import Program, write_program
from compplan.controllers.writers.text import LONGEST_COMMENT, clean_text, legal_name
from tests.controllers.test_golden_programs import FORMS, make_program, read_form

ATTACKS = {
    "line break": "a\nPTP {A1 90}\n;",
    "carriage return": "a\rPTP {A1 90}",
    "end of a block of data": "]]>PTP {A1 90}<![CDATA[",
    "end of an instruction": "; PTP {A1 90} ;",
    "quotes": "\" ' PTP {A1 90} \" '",
    "control letters": "\x00\x07\x1b[2J PTP {A1 90}",
    "other line ends": "a\x85PTP {A1 90}\u2028PTP {A1 90}\x0cPTP {A1 90}",
    "right to left": "\u202ePTP {A1 90}",
    "5000 letters": "PTP {A1 90}" * 500,
    "path": "../../PTP {A1 90}",
    "nothing": "",
    "no plain letter": "\u4e2d\u6587",
}
#: Letters that the controllers take, and that the writers give a name before its endings.
LONGEST = {"krl": 24, "val3": 32, "fanuc_ls": 36, "rapid": 32, "csv": 80, "urscript": 48, "sinumerik": 24, "inform": 32,
           "kawasaki_as": 15}  # fmt: skip
NAMES = {"krl": 21, "val3": 28, "fanuc_ls": 26, "rapid": 24, "csv": 60, "urscript": 40, "sinumerik": 20, "inform": 24,
         "kawasaki_as": 11}  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Program, Path]]:
    """Write a program with plain words once a language; return it and its folder."""

    @cache
    def write(language: str) -> tuple[Program, Path]:
        folder = tmp_path_factory.mktemp(language)
        plain = replace(make_program(folder / "cell", language), name="plain", comments=("plain",))
        write_program(plain, language, folder / "plain")
        return plain, folder / "plain"

    return write


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("attack", ATTACKS)
def test_text_never_becomes_robot_code(
    form: str, attack: str, tmp_path: Path, written: Callable[[str], tuple[Program, Path]]
) -> None:
    language, text = form.split()[0], ATTACKS[attack]
    plain, beside = written(language)
    program = replace(plain, name=text, robot=text, controller=text, comments=(text, text))
    files = write_program(program, language, tmp_path / "out")
    assert {file.resolve().is_relative_to((tmp_path / "out").resolve()) for file in files} == {True}
    for file in files:
        content = file.read_bytes().decode("ascii")
        assert re.fullmatch(r"[\t\r\n\x20-\x7e]*", content)
        assert not [line for line in re.split(r"[\r\n]+", content) if line.strip().startswith("PTP {A1 90}")]
        assert len(file.stem) <= LONGEST[language] and re.fullmatch(r"[A-Za-z]\w*", file.stem)
        if file.suffix in (".pgx", ".dtx", ".pjx"):
            ElementTree.fromstring(content)
    name = legal_name(text, NAMES[language])
    name = name.lower() if language == "kawasaki_as" else name
    name = f"P_{name}" if language == "sinumerik" and not name[1].isalpha() and name[1] != "_" else name
    moves, expected = read_form(form, tmp_path / "out", name), read_form(form, beside, "plain")
    assert [(move.kind, move.joints, move.stops, move.feed) for move in moves] == [
        (move.kind, move.joints, move.stops, move.feed) for move in expected
    ]


def test_the_name_of_a_job_never_becomes_robot_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write_job(tmp_path, "krl")
    job.write_text(job.read_text().replace('name = "golden"', 'name = """a\nPTP {A1 90}\n;"""'))
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    for file in (tmp_path / "out").glob("*.src"):
        assert not re.search(r"^PTP \{A1 90", file.read_text(), re.M)
        assert "; compplan: a PTP A1 90" in file.read_text()


@pytest.mark.parametrize("text", [*ATTACKS.values(), "Fräsbahn ½ Ø 3 mm", "a" * 99 + ";" + "b" * 99])
def test_a_comment_is_one_bounded_line_of_plain_letters(text: str) -> None:
    line = clean_text(text)
    assert len(line) <= LONGEST_COMMENT and re.fullmatch(r"[A-Za-z0-9 .,:+\-_/()=%#*]*", line)
    assert clean_text(line) == line


@pytest.mark.parametrize(
    ("text", "longest", "reserved", "name"),
    [
        ("ISF cone, 40 mm / 45 deg", 20, (), "ISF_cone_40_mm_45_de"),
        ("12 holes", 20, (), "p_12_holes"),
        ("", 20, (), "program"),
        ("test", 20, {"test"}, "test_p"),
        ("Test", 20, {"test"}, "Test_p"),
        ("con", 20, (), "con_p"),
        ("a" * 30, 10, {"a" * 10}, "a" * 8 + "_p"),
    ],
)
def test_names_are_what_every_controller_takes(text: str, longest: int, reserved: set[str], name: str) -> None:
    assert legal_name(text, longest, reserved=reserved) == name


def test_a_urscript_program_is_never_called_by_a_word_of_the_language(tmp_path: Path) -> None:
    program = replace(make_program(tmp_path / "cell", "urscript"), name="while")
    assert {file.stem for file in write_program(program, "urscript", tmp_path)} == {"while_p", "while_p_L"}


def test_fanuc_programs_end_their_lines_as_the_controller_reads_them(tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "fanuc_ls")
    for file in write_program(program, "fanuc_ls", tmp_path):
        content = file.read_bytes()
        assert content.count(b"\n") == content.count(b"\r\n") > 10


def test_a_fanuc_position_stands_to_the_letter_as_the_controller_prints_it(tmp_path: Path) -> None:
    text = write_program(make_program(tmp_path / "cell", "fanuc_ls"), "fanuc_ls", tmp_path)[-1].read_text()
    number = r" *-?\d+\."
    lines = re.findall(
        rf"^\tX ={number}\d{{5}}  mm,\tY ={number}\d{{5}}  mm,\tZ ={number}\d{{5}}  mm,\n"
        rf"\tW ={number}\d{{6}} deg,\tP ={number}\d{{6}} deg,\tR ={number}\d{{6}} deg",
        text,
        re.M,
    )
    assert len(lines) == 2


def test_a_val3_project_stops_by_dropping_its_motion_and_keeps_its_programs_whole(tmp_path: Path) -> None:
    files = {file.name: file for file in write_program(make_program(tmp_path / "cell", "val3"), "val3", tmp_path)}
    assert "<![CDATA[begin\n  resetMotion()\nend]]>" in files["stop.pgx"].read_text()
    for name, file in files.items():
        if name.endswith(".pgx"):
            (program,) = ElementTree.fromstring(file.read_text())
            assert {part.tag.rsplit("}")[-1] for part in program} <= {"Locals", "Code"}
            assert (program.text or "").strip() == "" and all((part.tail or "").strip() == "" for part in program)
