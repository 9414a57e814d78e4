"""Every effect and place of the vocabulary that a campaign can show, and the shapes that are tried for each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.rival.chain import Chain
from benchmarks.rival.log import Log
from benchmarks.rival.scene import ForwardModel, Spec
from benchmarks.rival.signatures import Columns

AXES = ("rx", "ry", "rz", "tx", "ty", "tz")
#: Waves a turn that are tried for an error of a gear, and time constants of a warm-up without thermometer. [s]
WAVES = np.arange(0.5, 170.0, 0.25)
WARMING = (300.0, 1000.0, 3000.0)
#: At most so many rows are tried as the moment of a shift.
MOMENTS = 24


def list_specs(scene: ForwardModel, registered: tuple[str, ...]) -> Iterator[Spec]:
    """List every effect and place of the vocabulary that a campaign can show, simple ones first."""
    chain, log = scene.chain, scene.log
    moving = [g.name for g in chain.segments if g.kind != "fixed"]
    springs = any(g.springs for g in chain.segments)
    loads = log.wrench[log.known]
    loaded = bool(np.ptp(loads[:, :3], axis=0).max() > 10.0) if len(loads) else False
    weighs = bool(np.any(scene.gravity)) and any(g.mass > 0.0 for g in chain.segments)
    for name in chain.joints:
        yield Spec("joint_offset", name)
        if loaded or (springs and weighs):
            yield Spec("joint_stiffness", name)
        yield Spec("backlash", name)
    if not chain.has_gravity or not springs:
        yield Spec("gravity_sag")
    yield from _frames(log, registered)
    if log.heat is not None:
        yield Spec("thermal_drift")
    elif log.timed:
        yield from (Spec("thermal_drift", shape=(tau,), tried=3) for tau in WARMING)
    if log.moving.any() and log.timed:
        yield Spec("time_skew")
        yield Spec("tracking_lag")
        yield from (Spec("tracking_lag", name) for name in chain.joints)
    if loaded and springs:
        yield Spec("wrench_scale")
        yield from (Spec("wrench_bias", shape=(word,)) for word in ("base", "sensor"))
    for name in moving:
        yield from (Spec("link_geometry", name, axis) for axis in AXES)
    if loaded or weighs:
        yield from (Spec("base_compliance", None, axis) for axis in AXES[:3])
        bends = [(name, axis) for name in moving for axis in AXES if not _is_own(chain, name, axis)]
        yield from (Spec("link_compliance", name, axis) for name, axis in bends)
    for name in chain.joints:
        yield from _nonlinear(scene, name, loaded or weighs)
        yield from (
            Spec("joint_coupling", name, shape=(o,), tried=len(chain.joints)) for o in chain.joints if o != name
        )
    if weighs and springs:
        yield Spec("payload")
        yield from (Spec("gravity_compensator", name) for name in chain.joints)


def _frames(log: Log, registered: tuple[str, ...]) -> Iterator[Spec]:
    if "base" not in registered:
        yield Spec("base_frame")
    if "tool" not in registered:
        yield Spec("tool_frame")
    starts = np.flatnonzero(np.r_[False, log.stay[1:] != log.stay[:-1]])
    starts = starts[(starts > 0.06 * len(log.q)) & (starts < 0.94 * len(log.q))]
    if len(starts):
        chosen = np.unique(starts[np.linspace(0, len(starts) - 1, MOMENTS).astype(int)])
        for row in chosen:
            yield Spec("tool_shift", shape=(float(row),), tried=len(chosen))
            yield Spec("frame_shift", shape=(float(row),), tried=len(chosen))


def _is_own(chain: Chain, name: str, axis: str) -> bool:
    segment = next(g for g in chain.segments if g.name == name)
    same = abs(float(np.eye(3)["xyz".index(axis[1])] @ segment.axis)) > 0.999
    return same and (axis[0] == "r") == (segment.kind == "revolute")


def _nonlinear(scene: ForwardModel, name: str, loaded: bool) -> Iterator[Spec]:
    columns = Columns(scene)
    own = columns.own(columns.known[name])
    if not own or not loaded:
        return
    size = float(np.nanquantile(np.abs(own[0][2]), 0.95))
    if size > 0.0:
        shapes = (("cubic", size), ("soft", 0.5 * size), ("zone", 0.1 * size), ("zone", 0.3 * size))
        yield from (Spec("stiffness_nonlinearity", name, shape=shape, tried=4) for shape in shapes)
