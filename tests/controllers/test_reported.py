"""What programs say beside where they lead: stops, configuration, turns, rates and load, by what the manuals say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.controllers.readback.poses import Move
from compplan.controllers.readback.reported import PostureWord, ReportedProgram, read_words
from compplan.controllers.writers.joint_convention import load_controller
from compplan.robot import load_robot

#: Joints of three rows, and the words that they stand in.
ARM = np.array([[10.0, -95.0, 100.0, -20.0, 50.0, 200.0], [95.0, 5.0, -5.0, 100.0, -30.0, -200.0], [-1.0] * 6])
ABOVE = {"shoulder": [True, False, True], "elbow": [True, True, False], "wrist": [False, True, True]}
NAMES = {"shoulder": ("front", "back"), "elbow": ("up", "down"), "wrist": ("flip", "noflip")}
STATUS = {"shoulder": {"front": 0, "back": 1}, "elbow": {"up": 2, "down": 0}, "wrist": {"noflip": 0, "flip": 4}}
LETTERS = {"shoulder": {"front": "T", "back": "B"}, "elbow": {"up": "U", "down": "D"},
           "wrist": {"noflip": "N", "flip": "F"}}  # fmt: skip
WORDS = {
    key: PostureWord(np.where(ABOVE[key], *NAMES[key]), np.ones(3, bool), STATUS[key], LETTERS[key]) for key in NAMES
}
NONE = np.zeros(3, bool)
WANTED = ReportedProgram(ARM, WORDS, NONE, NONE, np.full(3, np.nan), 12.0, np.array([1.0, 2.0, 3.0]))
#: Written by hand from the manuals: S and T of KRL, CONFIG of FANUC, cf1 cf4 cf6 cfx of RAPID, RCONF of INFORM.
SAID: dict[str, list[tuple[object, ...]]] = {
    "krl": [(2, 10), (7, 52), (4, 63)],
    "sinumerik": [(2, 10), (7, 52), (4, 63)],
    "fanuc_ls": [("N", "U", "T", "0", "0", "1"), ("F", "U", "B", "0", "0", "-1"), ("F", "D", "T", "0", "0", "0")],
    "rapid": [(0, -1, 2, 0), (1, 1, -3, 5), (-1, -1, -1, 3)],
    "inform": [(1, 0, 0, 0, 1, 0), (0, 0, 1, 0, 0, 0), (0, 1, 0, 0, 0, 0)],
}


def _moves(language: str) -> list[Move]:
    return [Move("line", row == 2, configuration=words) for row, words in enumerate(SAID[language])]


@pytest.mark.parametrize("language", SAID)
def test_words_that_fit_the_arm_are_accepted_and_any_other_is_named(language: str) -> None:
    moves = _moves(language)
    assert WANTED.compare(language, moves) == []
    for place, word in enumerate(SAID[language][1]):
        other = "X" if isinstance(word, str) and word.isalpha() else int(str(word)) + 1
        wrong = (*SAID[language][1][:place], other, *SAID[language][1][place + 1 :])
        (said,) = WANTED.compare(language, [moves[0], moves[1]._replace(configuration=wrong), moves[2]])
        assert f"is {other} at row 1" in said


def test_stops_are_those_of_the_plan() -> None:
    moves = [Move("line", stops) for stops in (False, False, True)]
    assert WANTED.compare("krl", moves) == []
    rest = replace(WANTED, exact_stops=np.array([False, True, False]))
    assert rest.compare("krl", moves) == ["the program runs through row 1, the plan does not"]
    assert WANTED.compare("krl", [moves[0]._replace(stops=True), *moves[1:]]) == [
        "the program stops at row 0, the plan does not"
    ]
    assert rest.compare("csv", moves) == []
    rapid = replace(WANTED, rapid=np.array([False, True, False]))
    assert rapid.compare("krl", [move._replace(stops=True) for move in moves]) == []


def test_axis_rates_and_load_are_those_of_plan_and_job() -> None:
    move = Move("joint", True, percent=40.0, load=(12.0, 1.0, 2.0, 3.0))
    shares = replace(WANTED, rapid=np.ones(3, bool), share=np.array([np.nan, 0.4, 0.4]))
    assert shares.compare("krl", [move] * 3) == []
    cut = replace(shares, rapid=NONE)
    moves = [move._replace(stops=row == 2) for row in range(3)]
    assert cut.compare("krl", moves) == []
    (said,) = cut.compare("krl", [moves[0], moves[1]._replace(percent=20.0), moves[2]])
    assert said == "20 % of the axis rates at row 1, the plan takes 40 %"
    (said,) = cut.compare("krl", [moves[0]._replace(load=(24.0, 1.0, 2.0, 3.0)), *moves[1:]])
    assert said == "a tool of 24 kg, the job's has 12"


def test_configuration_words_are_read_from_the_robot_folder() -> None:
    robot = load_robot("kuka_kr240")
    # KR 240-2: the elbow is down above -87.138 deg, the wrist does not flip from 0 deg up
    q = np.radians([[0.0, 20.0, -100.0, 0.0, 30.0, 0.0], [0.0, 20.0, -60.0, 0.0, 5e-3, 0.0]])
    words = read_words(load_controller(robot), robot, q)
    assert words["elbow"].values.tolist() == ["up", "down"]
    assert words["wrist"].values.tolist() == ["noflip", "noflip"] and words["wrist"].clear.tolist() == [True, False]
    assert words["shoulder"].values.tolist() == ["front", "front"]
