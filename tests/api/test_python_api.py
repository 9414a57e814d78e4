"""`import compplan as cp`: one verb a daily way, names that stay what they are, results that a person can read."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

import compplan as cp
from compplan.errors import InputError

mpl.use("Agg")
ROOT = Path(__file__).parents[2]
JOB = ROOT / "paths" / "circle_10mm.toml"


@pytest.fixture(scope="module")
def plan():
    return cp.plan(JOB, sampling={"max_step_mm": 2.0})


def ask(code: str) -> str:
    """Run a program in a process of its own, in which nothing was imported yet."""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert answer.returncode == 0, answer.stderr[-600:]
    return answer.stdout


def test_a_verb_stays_a_verb_whichever_room_of_its_name_is_imported_and_when() -> None:
    rooms_first, verb_first = (
        "import compplan.planning.compare; import compplan as cp",
        "import compplan as cp; cp.plan",
    )
    for order in (rooms_first, f"{verb_first}; import compplan.planning.nlp"):
        said = ask(
            f"{order}\nimport compplan.diagnosis.results.where as w\nfrom compplan import plan\n"
            "from compplan.planning import strategies\n"
            "import compplan.planning.compare as c\n"
            "assert cp.plan is plan and callable(plan) and callable(cp.diagnose)\n"
            "assert c.compare_task and w.split_diagnosis and strategies.STRATEGIES\n"
            "from unittest import mock\n"
            "with mock.patch('compplan.planning.compare.SAME', 3):\n    assert c.SAME == 3\n"
            "print(cp.plan.__doc__[:4])"
        )  # fmt: skip
        assert said == "Plan\n"


def test_the_names_are_few_and_none_of_them_is_a_tool_of_the_package() -> None:
    shown = [name for name in dir(cp) if not name.startswith("_")]
    assert sorted(shown) == sorted(cp.__all__) and len(set(cp.__all__)) == len(cp.__all__) <= 60
    assert not {"Any", "annotations", "importlib", "TYPE_CHECKING", "sys"} & set(shown)
    assert cp.prepare_study and cp.split_diagnosis  # names from before are found where they were


def test_a_plan_prints_on_a_screen_and_says_what_a_person_asks_first(plan) -> None:
    text = str(plan)
    assert text.count("\n") + 1 <= 15 and len(text) <= 2000 and max(map(len, text.splitlines())) <= 132
    assert "solved" in text and "95 % band" in text and "keep 0.1 mm" in text
    assert len(repr(plan)) <= 200 and len(repr(plan.robot)) <= 500 and len(repr(plan.task.nominal)) <= 300
    html = plan._repr_html_()
    assert html.count("<tr>") == len(plan.summary()) - 1 and "data:image/png;base64," in html
    assert "<table>" in plan.robot._repr_html_()


def test_a_plan_draws_into_axes_that_it_is_given_and_gives_them_back(plan) -> None:
    import matplotlib.pyplot as plt

    _, (left, right) = plt.subplots(1, 2)
    assert plan.plot(right) is right and not left.lines
    drawn = {line.get_label(): line for line in right.lines}
    np.testing.assert_allclose(np.nanmax(drawn["without correction"].get_ydata()), plan.before.max_deviation * 1e3)
    np.testing.assert_allclose(drawn["tolerance 0.1 mm"].get_ydata(), 0.1)
    assert right.get_xlabel().endswith("[mm]") and right.get_ylabel().endswith("[mm]")
    own = plan.plot()
    assert own.figure is not right.figure
    plt.close("all")


def test_a_plan_is_a_table_and_a_mapping(plan) -> None:
    columns = plan.columns()
    assert {len(values) for values in columns.values()} == {len(plan.task)}
    np.testing.assert_allclose(columns["q1_deg"], np.degrees(plan.q[:, 0]))
    assert json.loads(json.dumps(plan.to_dict()))["status"] == "solved"
    pandas = pytest.importorskip("pandas")
    frame = plan.to_frame()
    assert isinstance(frame, pandas.DataFrame) and list(frame) == list(columns)


def circle(count: int = 120) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    return np.column_stack([10.0 * np.cos(angle), 10.0 * np.sin(angle), 0.0 * angle])


def test_a_path_is_planned_alike_from_a_file_from_arrays_and_from_a_table(tmp_path) -> None:
    xyz, force = circle(), np.tile([0.0, 0.0, 300.0], (120, 1))
    columns = {"position_mm": xyz, "force_N": force, "moment_Nm": 0.0 * force, "feed_mm_s": 20.0}
    cp.write_toolpath(cp.read_toolpath(columns), tmp_path / "path.csv")
    more = {"robot": "staubli_tx200", "part": (1500.0, 0.0, 183.0), "plan": {"tolerance_mm": 0.05}}
    plain = {f"{a}_mm": xyz[:, k] for k, a in enumerate("xyz")} | {f"f{a}_N": force[:, k] for k, a in enumerate("xyz")}
    plain |= {f"m{a}_Nm": 0.0 for a in "xyz"} | {"feed_mm_s": 20.0}
    sources = [tmp_path / "path.csv", columns, plain, cp.read_toolpath(columns)]
    try:
        import pandas

        sources.append(pandas.DataFrame(plain))
    except ImportError:
        pass
    plans = [cp.plan(source, **more) for source in sources]
    assert {plan.status for plan in plans} == {"solved"} and {plan.task.tolerance for plan in plans} == {5e-5}
    assert plans[0].before.max_deviation > 1e-4
    for plan in plans[1:]:
        finer = np.interp(np.linspace(0, 1, 50), np.linspace(0, 1, len(plan.q)), plan.q[:, 1])
        whole = np.interp(np.linspace(0, 1, 50), np.linspace(0, 1, len(plans[0].q)), plans[0].q[:, 1])
        np.testing.assert_allclose(finer, whole, atol=2e-5)


def test_a_robot_in_memory_is_planned_and_judged_as_it_is() -> None:
    robot = cp.load_robot("kuka_kr270").scale_compliance(2.0)
    few = {"sampling": {"max_step_mm": 5.0}}
    soft, stiff = cp.plan(JOB, robot=robot, **few), cp.plan(JOB, **few)
    assert soft.status == "solved"
    assert soft.before.max_deviation == pytest.approx(2.0 * stiff.before.max_deviation, rel=0.02)


def test_a_path_without_names_of_columns_or_without_a_robot_is_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="without column names, so without units; give a DataFrame or"):
        cp.plan(circle(), robot="ur10")
    with pytest.raises(InputError, match="a path needs a robot"):
        cp.plan({"position_mm": circle(), "feed_mm_s": 20.0})
    with pytest.raises(InputError, match="no section named 'tolerance_mm' in a job"):
        cp.plan(JOB, tolerance_mm=0.1)
    with pytest.raises(InputError, match=r"has shape \(120, 2\), expected \(n, 3\)"):
        cp.read_toolpath({"position_mm": circle()[:, :2], "feed_mm_s": 20.0})


def test_a_verb_writes_what_its_command_writes(tmp_path) -> None:
    cp.plan(JOB, sampling={"max_step_mm": 5.0}, output={"programs": ["krl"]}, out=tmp_path / "out")
    assert {"plan.json", "joints.csv", "report.html"} <= {file.name for file in (tmp_path / "out").iterdir()}


def test_a_campaign_is_diagnosed_alike_from_arrays_and_a_comparison_says_who_is_equal(tmp_path) -> None:
    robot = write_small_robot(tmp_path / "robot")
    turned = cp.Effect("joint_offset", "joint_2", None, {"offset_rad": 1e-3})
    seen = measure(robot, plan_rows(robot, 5), [turned], seed=3)
    columns = {"run": seen.run, "q_deg": np.degrees(seen.q), "position_mm": seen.position * 1e3,
               "force_N": seen.wrench[:, :3], "moment_Nm": seen.wrench[:, 3:]}  # fmt: skip
    diagnosis = cp.diagnose(columns, tmp_path / "robot")
    assert [finding.effect.place[:2] for finding in diagnosis.verdict.findings] == [("joint_offset", "joint_2")]
    text = str(diagnosis)
    assert "joint_offset" in text and text.count("\n") < 15 and len(text) <= 2000 and len(repr(diagnosis)) < 200
    assert diagnosis.plot().lines and len(diagnosis.columns()["distance_before_mm"]) == len(seen)
    assert diagnosis.to_dict()["schema"] == 1 and len(str(seen)) < 2000

    comparison = cp.compare(JOB, sampling={"max_step_mm": 5.0})
    assert comparison.least == ("mirror", "iterated_mirror", "nlp")
    assert "mirror, iterated_mirror and nlp leave the same" in str(comparison) and len(str(comparison)) <= 2000
    assert comparison.plot().get_yscale() == "log" and set(comparison.columns()["strategy"]) == set(comparison.commands)
