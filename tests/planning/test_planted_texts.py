"""A feed that is 3 % off, or a point .1 mm off, in the text of a written program is seen in every language."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest
import tomli_w

import compplan.reporting.writers.plan as outputs
from compplan.planning.result import Plan
from compplan.reporting.writers.plan import deliver_plan
from tests.planning.test_delivery import ALL, plan_part

ROOT = Path(__file__).parents[2]
N = r"(-?[\d.]+)"
#: File of each language with moves of the tool, a feed in it, and a coordinate of a cut; what .1 mm is in its unit.
TEXTS: dict[str, tuple[str, str, str, float]] = {
    "krl": ("part_L1.src", rf"\$VEL\.CP={N}", rf"LIN \{{X {N}", 0.1),
    "rapid": ("part_L_1.mod", rf"\],\[{N},500,5000,1000\],(?!fine)", rf"MoveL \[\[{N}", 0.1),
    "fanuc_ls": ("PART_L.LS", rf"L P\[\d+\] {N}mm/sec", rf"X = +{N}", 0.1),
    "inform": ("PART_L.JBI", rf"MOVL C\d+ V={N}", rf"RCONF.*\nC\d+={N}", 0.1),
    "val3": ("part_L/part1.pgx", rf"mPath\.tvel={N}", "", 0.1),
    "val3 data": ("part_L/part_L.dtx", "", rf'<Value key="7" x="{N}"', 0.1),
    "urscript": ("part_p_L.script", rf"movel.* v={N}", rf"movel\(pose_trans\(part, p\[{N}", 1e-4),
    "kawasaki_as": ("part_l_1.as", rf"SPEED {N} MM/S", rf"(?m)^partlp\d+ {N}", 0.1),
    "sinumerik": ("PART.MPF", rf"G1 .* F{N}", rf"G1 X{N}", 0.1),
    "csv": ("part_joints.csv", r"(?m)^(?:[^,]*,){7}([\d.]+),0$", r"(?m)^[^,a-z]*,([-\d.]+),", 0.01),
}


@pytest.fixture(scope="module")
def delivered(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Plan, Path]]:
    """Deliver programs of every language; FANUC's for a robot whose folder has its words."""
    found: dict[str, tuple[Plan, Path]] = {}
    for languages in ([name for name in ALL if name != "fanuc_ls"], ["fanuc_ls"]):
        folder = tmp_path_factory.mktemp("planted")
        shutil.copytree(ROOT / "robots" / "kuka_kr240", folder / "robot")
        if languages == ["fanuc_ls"]:
            file = folder / "robot" / "controller.toml"
            table = tomllib.loads(file.read_text())
            letters = {"front": "T", "back": "B", "up": "U", "down": "D", "noflip": "N", "flip": "F"}
            for word in table["configuration"].values():
                word["native"] = {word[key]: letters[word[key]] for key in ("above", "below")}
            file.write_text(tomli_w.dumps(table))
        plan, _ = deliver_plan(plan_part(folder, "robot", languages), folder / "out")
        assert (plan.status, plan.breaches) == ("solved", ())
        found |= dict.fromkeys(languages, (plan, folder / "out"))
    return found


def change(file: Path, pattern: str, factor: float, shift: float) -> str:
    """Change the number in the middle one of the matches that are not zero; return the text before."""
    text = file.read_bytes().decode()
    found = [match for match in re.finditer(pattern, text) if float(match[1]) != 0.0]
    match = found[len(found) // 2]
    digits = len(match[1].partition(".")[2])
    number = f"{float(match[1]) * factor + shift:.{digits}f}"
    file.write_bytes(f"{text[: match.start(1)]}{number}{text[match.end(1) :]}".encode())
    return text


CASES = [(key, fault) for key, words in TEXTS.items() for k, fault in enumerate(("feed", "place")) if words[1 + k]]


@pytest.mark.parametrize(("text", "fault"), CASES)
def test_a_wrong_feed_or_place_in_a_text_is_seen(
    text: str, fault: str, delivered: dict[str, tuple[Plan, Path]]
) -> None:
    plan, folder = delivered[text.removesuffix(" data")]
    name, feed, place, size = TEXTS[text]
    pattern, factor, shift = (feed, 0.03, 0.0) if fault == "feed" else (place, 0.0, size)
    for sign in (1.0, -1.0):
        before = change(folder / name, pattern, 1.0 + sign * factor, sign * shift)
        try:
            said = outputs.read_back(plan, folder).breaches
        finally:
            (folder / name).write_bytes(before.encode())
        assert len(said) == 1, said
        assert ("feed" in said[0]) == (fault == "feed")
    assert outputs.read_back(plan, folder).breaches == ()
