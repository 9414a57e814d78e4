"""Page, terminal and diagnosis.json of one diagnosis never contradict each other."""

from __future__ import annotations

import html
import io
import json
import re
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.cli import main
from compplan.diagnose.ledger.unmodelled import names_alike
from compplan.effects import Effect
from compplan.files.tables import write_table

GEAR = Effect("transmission_error", "joint_1", None,
              {"cycles_per_turn": [1.0], "sine_rad": [6e-4], "cosine_rad": [4e-4]})  # fmt: skip
LENGTHS = [Effect("link_geometry", f"joint_{k}", axis, {f"{axis}_m": size})
           for k, axis, size in ((2, "tx", 2e-4), (3, "tz", -2.5e-4), (4, "ty", 1.5e-4), (5, "tx", -2e-4))]  # fmt: skip
#: What is wrong, poses, and a wave over the joints that no effect makes, without any load. [m]
CASES: dict[str, tuple[list[Effect], int, float]] = {
    "a gear beside a curve of another joint's angle": ([GEAR], 20, 2e-4),
    "small errors everywhere": (LENGTHS, 20, 0.0),
    "nothing but what no effect makes": ([], 20, 3e-4),
}


Answer = tuple[dict[str, Any], str, str]


@pytest.fixture(scope="module", params=CASES)
def answer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Answer:
    """What diagnosis.json holds, the page's text, and what the terminal shows, of a drawn campaign without load."""
    effects, poses, wave = CASES[request.param]
    out = tmp_path_factory.mktemp("drawn")
    robot = write_small_robot(out)
    log = measure(robot, plan_rows(robot, 20, poses=poses, loads=0), effects, 20, orientation=False)
    q = log.q
    seen = log.position + wave * np.sin(3.0 * q[:, [0, 1, 2]] + 2.0 * q[:, [2, 3, 4]] * q[:, [1, 0, 1]])
    log = replace(log, position=seen)
    columns = {f"q{k + 1}_deg": np.degrees(q[:, k]) for k in range(6)}
    columns |= {f"{axis}_mm": log.position[:, k] * 1e3 for k, axis in enumerate("xyz")}
    write_table(out / "log.csv", {"run": log.run, **columns}, decimals=6)
    words = ["diagnose", out / "log.csv", "--robot", robot.folder, "--out", out / "d", "--assume-ok"]
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), pytest.raises(SystemExit) as leaving:
        patch.setattr(sys, "argv", ["compplan", *(str(word) for word in words)])
        main()
    assert not leaving.value.code
    page = (out / "d" / "report.html").read_text(encoding="utf-8")
    body = re.sub(r"<script.*?</script>|<style.*?</style>", " ", page, flags=re.S)
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", body)))
    return json.loads((out / "d" / "diagnosis.json").read_text()), text, said.getvalue()


def test_no_error_that_nothing_makes_stands_beside_the_effect_that_makes_it(answer: Answer) -> None:
    table, page, terminal = answer
    for left in table["structure_left"]["depends_on"]:
        named = [(e["effect"], e["joint"]) for e in table["verdict"]["effects"]]
        makers = [place for place in named if names_alike(left["driver"], left["joint"], *place)]
        for said in (page, terminal):
            where = said.find(f"follows {left['driver']}")
            assert not makers or where < 0 or "beyond the named" in said[where : where + 200]
    if table["verdict"]["status"] == "calibrated":
        assert "no named effect makes" not in (page + terminal).lower()


def test_without_load_nothing_is_said_to_follow_it(answer: Answer) -> None:
    table, page, _ = answer
    where = table["where"]
    assert "load" not in where["by_factor"]
    assert "load" not in where.get("calibrated", {}).get("by_kind", {})
    assert "By load." not in page
    assert not re.search(r"by load \(|load \d+ % \(95", page)


def test_a_nominal_folder_is_not_planned_with_as_a_better_one(answer: Answer) -> None:
    table, page, terminal = answer
    nominal = table["delivered"][0]["kind"] == "nominal"
    assert ("Plan with the updated robot" in page and nominal) is False
    assert ("plan with it" in terminal) is not nominal


def test_named_effects_explain_no_more_than_the_gap(answer: Answer) -> None:
    table, page, _ = answer
    for number, unit in re.findall(r"against ([\d.]+) (mm|um|µm) that the named effects explain", page):
        told = float(number) * (1.0 if unit == "mm" else 1e-3)
        assert told <= 1.02 * table["gap"]["before_rms_mm"]
        assert told <= 1.02 * sum(effect["explained_rms_mm"] for effect in table["verdict"]["effects"])


def test_what_calibration_takes_up_to_the_noise_is_not_left_at_another_place_of_the_page(answer: Answer) -> None:
    _, page, _ = answer
    taken = "calibration takes it up to the noise" in page
    assert not taken or "structure is left that none of them explains" not in page


def test_page_terminal_and_file_name_the_same_status(answer: Answer) -> None:
    table, page, terminal = answer
    status = table["verdict"]["status"]
    assert f"verdict: {status.replace('_', ' ')}" in terminal
    said = {
        "none": "Nothing is wrong", "unknown": "none of the known effects explains",
        "calibrated": "was not calibrated", "explained": "Found", "partly_explained": "Found in part",
    }  # fmt: skip
    assert said[status] in page
    others = [words for key, words in said.items() if key not in (status, "explained")]
    assert not any(words in page for words in others)
