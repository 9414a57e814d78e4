"""Templates of other people are data: no template reaches a file, a class or a program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

import compplan as cp
from tests.regressions.test_robustness import write_job

#: What a template must not do: reach a file through an object, climb to a class, change what it is given.
HOSTILE = [
    '{{ cell.template.parent.joinpath("PWN").write_text("x") }}',
    '{{ cell["template"].parent.joinpath("PWN").write_text("x") }}',
    '{{ (cell|attr("template")).with_name("PWN").touch() }}',
    '{% for key in cell %}{% if key == "template" %}{{ cell[key].with_name("PWN").touch() }}{% endif %}{% endfor %}'
    "{{ cell.template }}",
    "{{ cell.__class__.__mro__ }}",
    "{{ name.__class__ }}",
    '{{ comments|map(attribute="__class__")|first }}',
    '{{ cell.__init__.__globals__["Path"]("PWN").touch() }}',
    '{{ "{0.__class__.__mro__}".format(name) }}',
    '{{ lipsum.__globals__["os"].system("touch PWN") }}',
    "{{ comments.clear() }}",
    '{{ cell.update({"tool": 1}) }}',
    '{% include "/etc/hostname" %}',
]


def build_program(template: Path) -> cp.Program:
    robot = cp.load_robot("kuka_kr270")
    q = np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0]) + np.linspace(0.0, 0.01, 3)[:, None]
    program = cp.build_program(robot, q, np.full(3, 0.01), np.array([True, False, False]), name="three")
    return replace(program, post=replace(program.post, template=template))


@pytest.mark.parametrize("language", ["own", "krl"])
@pytest.mark.parametrize("text", HOSTILE)
def test_a_template_reaches_nothing_but_its_words(text: str, language: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "mine.txt.jinja"
    own.write_text(text)
    with pytest.raises(cp.InputError, match=r"mine\.txt\.jinja"):
        cp.write_program(build_program(own), language, tmp_path / "out")
    assert [path.name for path in tmp_path.rglob("PWN")] == []


TYPES = """{% macro show(value) %}{% if value is mapping %}{% for key in value %}{{ show(value[key]) }}{% endfor %}
{% elif value is string or value is number or value is boolean or value is none %}
{% elif value is sequence %}{% for part in value %}{{ show(part) }}{% endfor %}
{% else %}foreign {{ value }}{% endif %}{% endmacro %}
{{ show([name, comments, cell, WORDS]) }}"""
WORDS = {
    "own": "robot, controller, joint_names, tool, base, mass_kg, centre_mm, moves, before",
    "krl": "parts, remarks, load, base, tool, rapid_percent, rail, carried",
}


@pytest.mark.parametrize("language", sorted(WORDS))
def test_a_template_gets_plain_data_alone(language: str, tmp_path: Path) -> None:
    own = tmp_path / "mine.txt.jinja"
    own.write_text(TYPES.replace("WORDS", WORDS[language]))
    written = cp.write_program(build_program(own), language, tmp_path / "out")
    assert all("foreign" not in file.read_text() for file in written)


def test_a_job_with_a_hostile_template_writes_nothing(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "mine.jinja").write_text('{{ cell.template.parent.joinpath("PWN").write_text("x") }}')
    job = write_job(tmp_path, more='[output]\nprograms = ["krl"]\ntemplates = { krl = "mine.jinja" }')
    done = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and "mine.jinja" in done.err and done.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["job.toml", "mine.jinja"]
