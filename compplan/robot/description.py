"""ROS robot descriptions: search of packages and meshes, expansion of xacro files to URDF."""

from __future__ import annotations

import ast
import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from compplan.errors import InputError
from compplan.io.parsing import guard_parser, parse_xml
from compplan.io.tables import read_text

#: Levels above a file at which packages are searched: package/urdf/file in a repository needs three.
LEVELS = 6
#: Allowed parts of an expression of a xacro file; user-defined functions and loops could run any code.
SAFE_NODES = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.Attribute, ast.Subscript, ast.Slice, ast.Tuple, ast.List,
    ast.Dict, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.BoolOp, ast.boolop, ast.Compare, ast.cmpop,
    ast.IfExp, ast.Call, ast.keyword,
)  # fmt: skip
#: Greatest length of an expression, and greatest exponent in one.
LONGEST, GREATEST_EXPONENT = 1000, 10


def find_package(name: str, start: Path) -> Path | None:
    """Find the folder of a ROS package by name, searching upwards.

    Args:
        name: Name of the package.
        start: A file or folder; folders above it and their siblings are searched.
    """
    if not name or name in (".", "..") or "/" in name:
        return None
    for folder in [start.resolve(), *start.resolve().parents][: LEVELS + 1]:
        if folder.name == name and folder.is_dir():
            return folder
        if (folder / name).is_dir():
            return folder / name
    return None


def find_mesh(address: str, folder: Path | None) -> Path | None:
    """Find the file of a mesh.

    Args:
        address: The `filename` of a URDF mesh: a path, file:// or package://PACKAGE/PATH.
        folder: Folder of the URDF. The path is relative to it, with or without the package, or to the package
            above it; `meshes/NAME` of the folder is tried last.
    """
    tail = Path(address.split("://", 1)[-1])
    if folder is None or not address:
        return None
    places = [folder / tail, folder / Path(*tail.parts[1:])]
    if address.startswith("package://") and ".." not in tail.parts:
        package = find_package(tail.parts[0] if tail.parts else "", folder)
        places += [] if package is None else [package / Path(*tail.parts[1:])]
    places.append(folder / "meshes" / tail.name)
    return next((file for file in places if file.is_file()), None)


def find_mesh_files(text: str, folder: Path) -> tuple[dict[Path, Path], list[str]]:
    """Find the meshes of a URDF, to be copied into a robot folder.

    Args:
        text: The URDF.
        folder: Its folder.

    Returns:
        File of each mesh by its path in the robot folder, and addresses that are not found or whose path is taken.
    """
    copies: dict[Path, Path] = {}
    missing = []
    for address in sorted({mesh.get("filename", "") for mesh in ElementTree.fromstring(text).iter("mesh")}):
        source = find_mesh(address, folder)
        tail = Path(address.split("://", 1)[-1])
        place = Path(*tail.parts[1:]) if address.startswith("package://") else tail
        if place.is_absolute() or ".." in place.parts:
            place = Path("meshes") / tail.name
        if source is None or copies.setdefault(place, source) != source:
            missing.append(address)
    return copies, missing


def read_description(file: Path) -> str:
    """Read a robot description as URDF text; a .xacro file is expanded.

    Raises:
        InputError: If it cannot be read or expanded, or is not a robot.
    """
    text = read_text(file)
    return expand_xacro(file) if file.suffix.lower() == ".xacro" or "<xacro:" in text else text


def expand_xacro(file: Path) -> str:
    """Expand a xacro file to URDF text, with the default of every argument.

    `$(find PACKAGE)` is searched by folder, without a ROS workspace. Expressions are arithmetic, comparisons and calls
    of xacro's functions.

    Raises:
        InputError: If a package is not found, or xacro cannot expand it.
    """
    import xacro

    silent = redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO())
    with guard_parser(file, "cannot be expanded by xacro"), _guard_xacro(file), silent[0], silent[1]:
        document = xacro.process_file(str(file))
        for node in [node for node in document.childNodes if node.nodeType == node.COMMENT_NODE]:
            document.removeChild(node)  # the banner of xacro
        text = str(document.toprettyxml(indent="  "))
    if not any(element.tag == "link" for element in parse_xml(text, file)):
        hint = "name the file that calls its macro" if "macro" in file.name else "expected a robot"
        raise InputError(f"expands to a robot without links; {hint}", file=file)
    return text


@contextmanager
def _guard_xacro(file: Path) -> Iterator[None]:
    """Restrict xacro to packages found by folder, safe expressions, and XML without document types."""
    import xacro
    from xacro import substitution_args

    parse = xacro.parse

    def locate(package: str) -> str:
        found = find_package(package, file)
        if found is None:
            raise InputError(f"package {package!r} is not found in the folders above; put it beside the others",
                             file=file)  # fmt: skip
        return str(found)

    def read(given: Any, filename: str | None = None) -> Any:
        if given is None and filename is not None and Path(filename).is_file():
            parse_xml(read_text(Path(filename)), Path(filename))
        return parse(given, filename)

    def evaluate(expression: str, names: dict[str, Any], local: Any = None) -> Any:
        tree = ast.parse(expression.strip(), "<expression>", "eval")
        _check_expression(tree, expression)
        names.update(__builtins__={})
        return eval(compile(tree, "<expression>", "eval"), names, local)

    def refuse(text: str, context: Any) -> str:
        raise InputError(f"$(eval {text}) is not evaluated; write ${{...}}", file=file)

    offered = (substitution_args._eval_find, xacro.safe_eval, substitution_args._eval)
    substitution_args._eval_find, xacro.safe_eval, substitution_args._eval = locate, evaluate, refuse
    xacro.parse = read
    try:
        yield
    finally:
        substitution_args._eval_find, xacro.safe_eval, substitution_args._eval = offered
        xacro.parse = parse


def _check_expression(tree: ast.AST, text: str) -> None:
    """Refuse an expression that could run code."""
    if len(text) > LONGEST:
        raise ValueError(f"an expression has {len(text)} letters, at most {LONGEST}")
    for node in ast.walk(tree):
        private = isinstance(node, ast.Attribute) and node.attr.startswith("_")
        private = private or (isinstance(node, ast.Name) and node.id.startswith("__"))
        power = False
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            exponent = node.right.value if isinstance(node.right, ast.Constant) else None
            power = not isinstance(exponent, int | float) or abs(exponent) > GREATEST_EXPONENT
        if not isinstance(node, SAFE_NODES) or private or power:
            raise ValueError(f"{text.strip()[:60]!r} is more than arithmetic and calls")
