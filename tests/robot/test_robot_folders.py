"""The robot folders: they load, stand where they should, and count as their controllers do. Pinocchio is the judge."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from robot_library import REDUNDANT, over_robots
from robot_sources import SOURCES

from compplan.effects import Effect, fold_effects
from compplan.errors import InputError
from compplan.robot import as_read, read_robot_folder, robot_folders, write_robot_folder

Array = NDArray[np.float64]

ROBOTS = Path(__file__).parents[2] / "robots"
NAMES = sorted(folder.name for folder in ROBOTS.iterdir() if (folder / "robot.urdf").is_file())
SHIPPED = [
    "fanuc_m10ia", "kuka_kr120_r3900", "kuka_kr240", "kuka_kr240_rail",
    "kuka_kr270", "kuka_kr270_full", "staubli_tx200", "ur10",
]  # fmt: skip
LIBRARY = over_robots()
KUKA_ARMS = {  # a1, d1 + a2, d4 + d6, step from elbow axis to wrist axis; m
    "kuka_kr270": (0.35, 0.675 + 1.15, 1.2 + 0.24, -0.041),
    "kuka_kr270_full": (0.35, 0.675 + 1.15, 1.2 + 0.24, -0.041),
    "kuka_kr120_r3900": (0.73, 0.55 + 1.35, 1.82 + 0.215, 0.115),
    "kuka_kr240": (0.35, 0.75 + 1.25, 1.1 + 0.23, -0.055),
    "kuka_kr240_rail": (0.35, 0.5 + 0.75 + 1.25, 1.1 + 0.23, -0.055),
}
MASSES = {
    "fanuc_m10ia": 130, "kuka_kr120_r3900": 1220, "kuka_kr240": 1267, "kuka_kr240_rail": 1500 + 600 + 1267,
    "kuka_kr270": 1129, "kuka_kr270_full": 1129, "staubli_tx200": 1000 + 5,
    "ur10": 4 + 7.1 + 12.7 + 4.27 + 2 + 2 + 0.365,
} | {name: source.mass for name, source in SOURCES.items()}  # fmt: skip
WORKING_POSTURE_DEG: dict[str, list[float]] = {  # the rail's 85.9 deg are 1.5 rad, that is 1.5 m
    "fanuc_m10ia": [0, 20, -10, 0, -60, 0], "kuka_kr120_r3900": [0, -80, 100, 0, 60, 0],
    "kuka_kr240": [0, 80, -195, 0, 60, 0], "kuka_kr240_rail": [85.9, 0, 80, -195, 0, 60, 0],
    "kuka_kr270": [0, 10, -110, 0, 45, 0],
    "kuka_kr270_full": [0, 10, -110, 0, 45, 0], "staubli_tx200": [0, 49.7, 89.3, 0, 41, 0],
    "ur10": [0, -100, 110, -100, -90, 0],
} | {name: list(source.work) for name, source in SOURCES.items()}  # fmt: skip
ELASTICITY_KEYS = {
    "schema", "grade", "tcp", "flange", "gravity", "acceleration_limits", "repeatability_mm",
    "sources", "spring", "link",
}  # fmt: skip
SOURCES = {"compliance", "geometry", "masses", "limits", "velocities", "accelerations"}


def read_toml(name: str, file: str) -> dict[str, Any]:
    return tomllib.loads((ROBOTS / name / file).read_text(encoding="utf-8"))


def load_model(name: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(ROBOTS / name / "robot.urdf"))


def place(model: pin.Model, q: Array, frame: str) -> pin.SE3:
    assert model.existFrame(frame)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, float))
    return data.oMf[model.getFrameId(frame)]


def to_robot(name: str, controller_deg: list[float]) -> Array:
    """Turn what the controller shows into joint positions [rad, m]."""
    table = read_toml(name, "controller.toml")
    size = len(controller_deg)
    matrix = np.diag(table["sign"]) + np.array(table.get("coupling", np.zeros((size, size))))
    q = np.linalg.solve(matrix.astype(float), np.array(controller_deg, float) - table["zero_deg"])
    prismatic = np.array([joint.shortname() == "JointModelPY" for joint in load_model(name).joints[1:]])
    return np.where(prismatic, q * 1e-3, np.radians(q))


def kuka(name: str, axes_deg: list[float]) -> Array:
    return to_robot(name, [0.0, *axes_deg] if name.endswith("rail") else axes_deg)


def test_every_robot_that_is_promised_is_there() -> None:
    assert set(SHIPPED) <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_folder_loads_with_named_joints_frames_and_finite_limits(name: str) -> None:
    model = load_model(name)
    assert model.name == name
    assert list(model.names)[1:] == [f"joint_{i}" for i in range(1, model.nq + 1)]
    assert all(model.existFrame(frame) for frame in ("base_link", "link_1", "flange", "tool0"))
    effort = model.upperEffortLimit if hasattr(model, "upperEffortLimit") else model.effortLimit  # renamed in Pinocchio
    limits = np.array([model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit, effort], float)
    assert np.isfinite(limits).all() and (np.abs(limits) < 1e5).all()
    assert (limits[0] < limits[1]).all() and (limits[2:] > 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_elasticity_has_known_keys_sources_and_positive_springs(name: str) -> None:
    table, model = read_toml(name, "elasticity.toml"), load_model(name)
    assert set(table) <= ELASTICITY_KEYS and table["schema"] == 1
    assert table["grade"] in ("identified", "literature", "scaled", "placeholder")
    stated = [spring for spring in table.get("spring", []) if "link_share" in spring]
    assert len(stated) == sum(spring.get("actuator", spring["axis"] == "own") for spring in table.get("spring", []))
    assert all(spring["link_share"] == (0.0 if table.get("link") else 0.4) for spring in stated)
    assert set(table["sources"]) == SOURCES | ({"link_share"} if stated else set()) and all(table["sources"].values())
    assert (table["tcp"], table["flange"]) == ("tool0", "flange")
    assert len(table["acceleration_limits"]) == model.nq and min(table["acceleration_limits"]) > 0
    for spring in table.get("spring", []):
        assert set(spring) <= {"joint", "axis", "compliance", "offset", "actuator", "link_share"}
        assert model.existJointName(spring["joint"])
        assert spring["axis"] in ("own", "tx", "ty", "tz", "rx", "ry", "rz")
        assert 1e-9 < spring["compliance"] < 3e-4
    for link in table.get("link", []):
        assert set(link) == {"link", "beam"} and model.existFrame(link["link"])
        beam = link["beam"]
        assert set(beam) == {"length", "outer_diameter", "inner_diameter", "young", "shear", "axis"}
        assert beam["outer_diameter"] > beam["inner_diameter"] > 0
        assert beam["shear"] == pytest.approx(beam["young"] / (2 * 1.33), rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_controller_counts_every_joint_and_its_words_refer_to_things_that_exist(name: str) -> None:
    table, model = read_toml(name, "controller.toml"), load_model(name)
    assert set(table) <= {
        "schema",
        "controller",
        "joint_names",
        "sign",
        "zero_deg",
        "coupling",
        "configuration",
        "world",
        "pendant",
    }
    pendant = table["pendant"]  # the maker's flange frame: two unit axes across each other, and where they come from
    assert np.dot(pendant["x"], pendant["z"]) == pytest.approx(0.0, abs=1e-9) and len(pendant["source"]) > 10
    assert len(table["sign"]) == len(table["zero_deg"]) == len(table["joint_names"]) == model.nq
    assert set(table["sign"]) <= {-1, 1}
    assert np.shape(table.get("coupling", np.zeros((model.nq, model.nq)))) == (model.nq, model.nq)
    assert set(table["configuration"]) == {"shoulder", "elbow", "wrist"}
    for word in table["configuration"].values():
        assert word["above"] != word["below"]
        assert model.existJointName(word["joint"]) if "joint" in word else model.existFrame(word["point"])


@pytest.mark.parametrize("name", LIBRARY)
def test_the_masses_sum_to_what_the_folder_states_and_every_inertia_is_physical(name: str) -> None:
    model = load_model(name)
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(MASSES[name])
    for inertia in list(model.inertias)[1:]:
        a, b, c = np.sort(np.linalg.eigvalsh(inertia.inertia))
        assert a > 0 and a + b >= c * (1 - 1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_tool_frame_has_its_z_axis_out_of_the_flange(name: str) -> None:
    model = load_model(name)
    q = pin.neutral(model)
    last_axis = model.joints[model.njoints - 1].createData()
    model.joints[model.njoints - 1].calc(last_axis, q, np.zeros(model.nv))
    out_of_flange = place(model, q, f"link_{model.nq}").rotation @ last_axis.S[3:].ravel()
    tool_z = place(model, q, "tool0").rotation[:, 2]
    assert abs(tool_z @ out_of_flange) == pytest.approx(1.0)
    last_link = place(model, q, f"link_{model.nq}")  # the TX200's carries a tool beyond the flange
    body = last_link.translation if name == "staubli_tx200" else last_link.act(model.inertias[model.nq].lever)
    assert tool_z @ (place(model, q, "flange").translation - body) > 0.003


@pytest.mark.parametrize("name", KUKA_ARMS)
def test_a_kuka_in_its_mastering_like_home_has_its_arm_level_in_front(name: str) -> None:
    a1, elbow_height, forearm, step = KUKA_ARMS[name]
    tip = place(load_model(name), kuka(name, [0, -90, 90, 0, 0, 0]), "tool0")
    assert tip.translation == pytest.approx([a1 + forearm, 0, elbow_height + step], abs=1e-9)
    assert tip.rotation == pytest.approx(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), abs=1e-9)


@pytest.mark.parametrize("name", KUKA_ARMS)
def test_kuka_axes_turn_as_the_controller_counts_them(name: str) -> None:
    model, home = load_model(name), np.array([0, -90, 90, 0, 0, 0.0])
    before = place(model, kuka(name, list(home)), "tool0")
    turned = [place(model, kuka(name, list(home + 10 * np.eye(6)[i])), "tool0") for i in range(6)]
    assert turned[0].translation[1] < -0.1
    assert all(turned[i].translation[2] < before.translation[2] - 0.01 for i in (1, 2, 4))
    for i in (3, 5):
        turn = pin.log3(turned[i].rotation @ before.rotation.T)
        assert turn == pytest.approx([-np.radians(10), 0, 0], abs=1e-9)


def test_the_kuka_reaches_agree_with_their_names() -> None:
    kr120 = load_model("kuka_kr120_r3900")
    wrist = place(kr120, np.radians([0, 0, np.degrees(np.arctan2(0.115, 1.82)), 0, 0, 0]), "link_5")
    assert wrist.translation[0] == pytest.approx(3.904, abs=5e-4)
    kr240 = load_model("kuka_kr240")
    straight = -90 + np.degrees(np.arctan2(0.055, 1.1))
    wrist = place(kr240, np.radians([0, 0, straight, 0, 0, 0]), "link_5")
    assert wrist.translation[0] == pytest.approx(2.70, abs=2e-3)


def test_the_full_kr270_moves_as_the_reduced_one_and_its_beams_end_at_the_next_joint() -> None:
    reduced, full = load_model("kuka_kr270"), load_model("kuka_kr270_full")
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(reduced.lowerPositionLimit, reduced.upperPositionLimit)
        assert place(full, q, "tool0").isApprox(place(reduced, q, "tool0"), 1e-12)
    q = pin.neutral(full)
    ends = {"link_1": "link_2", "link_2": "link_3", "link_3": "link_3_end", "link_3_end": "link_4", "link_6": "flange"}
    for link in read_toml("kuka_kr270_full", "elasticity.toml")["link"]:
        near, far = place(full, q, link["link"]), place(full, q, ends[link["link"]])
        beam = link["beam"]
        direction = far.rotation[:, "xyz".index(beam["axis"][-1])] * (-1 if beam["axis"].startswith("-") else 1)
        assert far.translation - near.translation == pytest.approx(beam["length"] * direction, abs=1e-9)


def test_the_fanuc_keeps_its_forearm_level_while_j3_stands_still_and_j2_moves() -> None:
    model = load_model("fanuc_m10ia")
    for j2 in (-30.0, 0.0, 40.0):
        assert place(model, to_robot("fanuc_m10ia", [0, j2, 0, 0, 0, 0]), "tool0").rotation[:, 2] == pytest.approx(
            [1, 0, 0], abs=1e-9
        )
    down = place(model, to_robot("fanuc_m10ia", [0, 20, 0, 0, -90, 0]), "tool0")
    assert down.rotation[:, 2] == pytest.approx([0, 0, -1], abs=1e-9)


@pytest.mark.parametrize("name", sorted(set(NAMES) - REDUNDANT))
def test_the_straight_arm_is_where_the_elbow_words_change(name: str) -> None:
    elbow, model = read_toml(name, "controller.toml")["configuration"]["elbow"], load_model(name)
    index = int(elbow["joint"][-1])
    q = pin.neutral(model)
    q[index - 1] = np.radians(elbow["threshold_deg"])
    wrist = "link_4" if name.startswith("ur") else "link_6" if name == "kuka_kr240_rail" else "link_5"
    points = [place(model, q, frame).translation for frame in (f"link_{index - 1}", f"link_{index}", wrist)]
    upper, fore = points[1] - points[0], points[2] - points[1]
    joint = model.joints[index].createData()  # arms may be offset sideways, along the elbow axis
    model.joints[index].calc(joint, q, np.zeros(model.nv))
    axis = place(model, q, f"link_{index}").rotation @ joint.S[3:].ravel()
    upper, fore = (part - axis * (axis @ part) for part in (upper, fore))
    assert upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore) == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("name", sorted(set(NAMES) - REDUNDANT))
def test_the_working_posture_lies_within_limits_and_is_named_front_up_noflip(name: str) -> None:
    model, words = load_model(name), read_toml(name, "controller.toml")["configuration"]
    q = np.radians(WORKING_POSTURE_DEG[name])
    assert (model.lowerPositionLimit < q).all() and (q < model.upperPositionLimit).all()
    shoulder = words["shoulder"]
    frame, point = place(model, q, shoulder["frame"]), place(model, q, shoulder["point"])
    x = frame.actInv(point.translation)["xyz".index(shoulder["axis"])] * 1e3
    found = [shoulder["above" if x >= shoulder["threshold_mm"] else "below"]]
    for key in ("elbow", "wrist"):
        word = words[key]
        angle = np.degrees(q[int(word["joint"][-1]) - 1]) - word["threshold_deg"]
        found.append(word["above" if (angle + 180) % 360 - 180 >= 0 else "below"])
    assert found == ["front", "up", "noflip"]


@pytest.mark.parametrize("name", LIBRARY)
def test_only_neighbouring_links_touch_around_the_working_posture(name: str) -> None:
    file = str(ROBOTS / name / "robot.urdf")
    model = load_model(name)
    shapes = pin.buildGeomFromUrdf(model, file, pin.GeometryType.COLLISION, package_dirs=[])
    drawn = pin.buildGeomFromUrdf(model, file, pin.GeometryType.VISUAL, package_dirs=[])
    assert shapes.ngeoms == drawn.ngeoms >= model.nq + 1
    objects = shapes.geometryObjects
    for i in range(shapes.ngeoms):
        for j in range(i):
            if abs(objects[i].parentJoint - objects[j].parentJoint) > 1:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
    assert len(shapes.collisionPairs) > 10
    rng = np.random.default_rng(7)
    spread = np.radians([60, 15, 15, 60, 25, 180.0])
    data, shape_data = model.createData(), shapes.createData()
    for _ in range(40):
        q = np.radians(WORKING_POSTURE_DEG[name])
        q[-6:] += rng.uniform(-spread, spread)
        assert not pin.computeCollisions(model, data, shapes, shape_data, q, True), np.degrees(q)


def test_a_robot_as_read_is_the_one_that_its_written_folder_gives(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    for number, source in enumerate(robot_folders().values()):
        robot = read_robot_folder(source)
        turning = next(joint for joint in robot.actuated if joint.kind != "prismatic")
        step = dict(zip(("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad"), random.normal(0, 1e-4, 6), strict=True))
        effects = [
            Effect("link_geometry", turning.name, None, step),
            Effect("backlash", turning.name, None, {"width_rad": 1.0 / 3e4}),
        ]
        robot = fold_effects(robot, effects)
        write_robot_folder(robot, tmp_path / str(number))
        written, read = read_robot_folder(tmp_path / str(number)), as_read(robot)
        assert read.urdf == written.urdf and read.effects == written.effects
        assert repr(read.springs) == repr(written.springs)
        assert [j.placement.tolist() for j in read.joints] == [j.placement.tolist() for j in written.joints]
        assert [j.axis.tolist() for j in read.joints] == [j.axis.tolist() for j in written.joints]
        assert [(b.link, b.mass, b.centre.tolist()) for b in read.bodies] == [
            (b.link, b.mass, b.centre.tolist()) for b in written.bodies
        ]
        assert [b.compliance.tolist() for b in read.link_elasticities] == [
            b.compliance.tolist() for b in written.link_elasticities
        ]


def test_a_robot_that_could_not_be_read_is_none_as_read_either(tmp_path: Path) -> None:
    robot = read_robot_folder(next(iter(robot_folders().values())))
    softer = replace(robot, springs=(replace(robot.springs[0], compliance=1.0), *robot.springs[1:]))
    with pytest.raises(InputError, match="compliance"):
        as_read(softer)
