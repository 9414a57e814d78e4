"""The packages of compplan: imports point down, none go in a circle, and there are few."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

from importlinter.cli import lint_imports

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "compplan"


def name_module(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def read_imports(file: Path, modules: set[str]) -> set[str]:
    """Modules of the package that a file imports, at any depth of its text."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            named = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in modules else node.module for name in named}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & modules


def test_imports_point_down(monkeypatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("logging.config.dictConfig", lambda table: None)  # it silences every logger of later tests
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_no_imports_go_in_a_circle() -> None:
    files = {name_module(file): file for file in PACKAGE.rglob("*.py")}
    graph = {name: read_imports(file, set(files)) - {name} for name, file in files.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(files) > 200


def test_there_are_at_most_26_packages() -> None:
    packages = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert len(packages - {"__init__", "__main__", "version"}) <= 26


def test_no_class_of_the_package_has_the_name_of_another() -> None:
    """Nouns of the field are told apart: IdentifiedGap and Gap, RobotPosterior and Posterior."""
    places: dict[str, list[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name_module(file))
    assert not {name: found for name, found in places.items() if len(found) > 1}
