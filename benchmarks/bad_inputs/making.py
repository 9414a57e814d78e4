"""Put one fault into a copy of the good workspace."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from benchmarks.bad_inputs.tables import EDITS, GOOD, BadInput


def make_workspace(case: BadInput, folder: Path) -> None:
    """Copy the good workspace to a folder and carry out the edit of a case there."""
    shutil.copytree(GOOD, folder, dirs_exist_ok=True)
    for name, content in case.edit.get("contents", {}).items():
        (folder / name).write_text(content, encoding="utf-8", errors="surrogatepass", newline="")
    edits = [name for name in EDITS if name in case.edit]
    if not edits or "disk" in edits:
        return
    file = folder / case.edit["file"]
    if "mode" in edits:
        file.chmod(int(case.edit["mode"], 8))
    elif "encode" in edits:
        file.write_bytes(file.read_text(encoding="utf-8").encode(case.edit["encode"]))
    elif set(edits) & {"delete", "folder", "link", "pipe", "sparse"}:
        replace_thing(file, case.edit)
    elif "bytes" in edits:
        file.write_bytes(bytes.fromhex(case.edit["bytes"]))
    else:
        old = file.read_text(encoding="utf-8") if file.exists() else ""
        new = edit_text(old, case.edit)
        if new == old and file.exists():
            raise ValueError(f"{case.name}: the edit changes nothing")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(new, encoding="utf-8")


def replace_thing(file: Path, edit: Mapping[str, Any]) -> None:
    """Take a file away and put something in its place that is not an ordinary file."""
    file.unlink()
    if "folder" in edit:
        file.mkdir()
    elif "link" in edit:
        file.symlink_to(edit["link"])
    elif "pipe" in edit:
        os.mkfifo(file)
    elif "sparse" in edit:
        with file.open("wb") as stream:
            stream.truncate(int(edit["sparse"]))


def edit_text(text: str, edit: Mapping[str, Any]) -> str:
    """Return the text of a file with one edit carried out."""
    to = str(edit.get("to", ""))
    if "set" in edit:
        return set_key(text, edit["set"], to)
    if "drop" in edit:
        return set_key(text, edit["drop"], None)
    if {"attr", "remove", "insert"} & set(edit):
        return _edit_xml(text, edit, to)
    if {"column", "rename", "cut", "rows"} & set(edit):
        return _edit_csv(text, edit, to)
    if "replace" in edit:
        if edit["replace"] not in text:
            raise ValueError(f"no {edit['replace']!r} in the file")
        return text.replace(edit["replace"], to)
    if "repeat" in edit:
        piece, times = edit["repeat"]
        return str(edit.get("head", "")) + piece * times + str(edit.get("tail", ""))
    return str(edit["text"])


def set_key(text: str, key: str, raw: str | None) -> str:
    """Set a key of a TOML text to raw TOML, or take it out; `spring[2].axis` is a key of the third [[spring]]."""
    table, _, name = key.rpartition(".")
    lines = text.splitlines()
    counts: dict[str, int] = {}
    current, end, found = "", None, None
    for number, line in enumerate(lines):
        if header := re.match(r"\s*(\[+)([^\]]+)\]", line):
            current = header[2].strip()
            if len(header[1]) == 2:
                counts[current] = counts.get(current, -1) + 1
            array = next((array for array in counts if current == array or current.startswith(array + ".")), None)
            if array:
                current = current.replace(array, f"{array}[{counts[array]}]", 1)
        if current == table:
            end = number + 1 if line.strip() and not line.strip().startswith("#") else end
            if re.match(rf"\s*{re.escape(name)}\s*=", line):
                found = number
    if found is not None:
        lines[found : found + 1] = [] if raw is None else [f"{name} = {raw}"]
    elif raw is None:
        raise ValueError(f"no key {key!r} to take out")
    elif not table:
        lines.insert(0, f"{name} = {raw}")
    elif end is None:
        lines += [f"[{table}]", f"{name} = {raw}"]
    else:
        lines.insert(end, f"{name} = {raw}")
    return "\n".join(lines) + "\n"


def _edit_xml(text: str, edit: Mapping[str, Any], to: str) -> str:
    root = ElementTree.fromstring(text)
    if "attr" in edit:
        path, _, name = edit["attr"].rpartition("@")
        element = _find(root, path)
        if to == "DROP":
            del element.attrib[name]
        else:
            element.set(name, to)
    elif "remove" in edit:
        parent, _, _ = edit["remove"].rpartition("/")
        _find(root, parent or ".").remove(_find(root, edit["remove"]))
    else:
        for piece in ElementTree.fromstring(f"<some>{to}</some>"):
            _find(root, edit["insert"]).append(piece)
    return ElementTree.tostring(root, encoding="unicode")


def _find(root: ElementTree.Element, path: str) -> ElementTree.Element:
    element = root if path in ("", ".") else root.find(path)
    if element is None:
        raise ValueError(f"no element {path!r}")
    return element


def _edit_csv(text: str, edit: Mapping[str, Any], to: str) -> str:
    header, *rows = list(csv.reader(text.splitlines()))
    if "rows" in edit:
        rows = rows[: edit["rows"]]
    elif "rename" in edit:
        header[header.index(edit["rename"])] = to
    elif "cut" in edit:
        gone = [header.index(name) for name in edit["cut"].split()]
        header, *rows = [[value for k, value in enumerate(row) if k not in gone] for row in (header, *rows)]
    else:
        places = []
        for name in edit["column"].split():
            if name not in header:
                header.append(name)
                rows = [[*row, "0"] for row in rows]
            places.append(header.index(name))
        for number, row in enumerate(rows):
            if edit.get("row", number) == number:
                for place in places:
                    row[place] = repr(float(row[place]) * edit["scale"]) if "scale" in edit else to
    lines = io.StringIO()
    csv.writer(lines, lineterminator="\n").writerows([header, *rows])
    return lines.getvalue()
