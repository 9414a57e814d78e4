"""Files are data: nothing that is read becomes code, and what a program opens to others is stated."""

import ast
from functools import cache
from pathlib import Path

import pytest

import compplan
from compplan.errors import InputError
from compplan.io.parsing import parse_xml

PACKAGE = Path(compplan.__file__).parent
#: Calls that turn text or bytes into code or objects, and the files that may make them: workers get what their own
#: parent packed, and expressions of xacro files are checked against a list of allowed nodes first.
FORBIDDEN = {"eval", "exec", "os.system", "os.popen", "pickle.load", "pickle.loads", "marshal.loads", "yaml.load"}
ALLOWED = {("studies/workers.py", "pickle.loads"), ("robot/description.py", "eval")}


def name_call(node: ast.Call) -> str:
    if isinstance(node.func, ast.Name):
        return node.func.id
    if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
        return f"{node.func.value.id}.{node.func.attr}"
    return ""


@cache
def list_calls():
    return [
        (file.relative_to(PACKAGE).as_posix(), node)
        for file in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


def test_no_text_becomes_code():
    found = {(file, name_call(node)) for file, node in list_calls() if name_call(node) in FORBIDDEN}
    assert found == ALLOWED


def test_arrays_are_read_without_pickled_objects_and_no_shell_is_started():
    loads = [node for _, node in list_calls() if name_call(node) == "np.load"]
    assert len(loads) >= 2
    for node in loads:
        given = {word.arg: word.value for word in node.keywords}
        assert isinstance(given["allow_pickle"], ast.Constant) and given["allow_pickle"].value is False
    shells = [word for _, node in list_calls() for word in node.keywords if word.arg == "shell"]
    assert shells == []


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]><r>&a;</r>',
        '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><r>&b;</r>',
        '<!DOCTYPE r SYSTEM "r.dtd"><r/>',
    ],
)
def test_entities_of_xml_are_refused_before_they_are_followed(text):
    with pytest.raises(InputError, match="DOCTYPE"):
        parse_xml(text, Path("robot.urdf"))


def test_xml_is_bounded_in_size():
    with pytest.raises(InputError, match="more than"):
        parse_xml("<a>" + "<b/>" * 200_001 + "</a>", Path("robot.urdf"))
