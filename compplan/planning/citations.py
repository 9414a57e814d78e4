"""Whose methods a plan rests on: papers and books to cite, by what the plan made use of."""

from __future__ import annotations

from collections.abc import Iterable

from compplan.process.force_models import FORCE_MODELS

#: The papers, by what is used of them.
METHODS = {
    "joint springs": "J. K. Salisbury: Active stiffness control of a manipulator in Cartesian coordinates, "
    "IEEE Conference on Decision and Control, 1980",
    "stiffness under load": "S.-F. Chen, I. Kao: Conservative congruence transformation for joint and Cartesian "
    "stiffness matrices of robotic hands and fingers, International Journal of Robotics Research 19(9), 2000",
    "timing": "H. Pham, Q.-C. Pham: A new approach to time-optimal path parameterization based on reachability "
    "analysis, IEEE Transactions on Robotics 34(3), 2018",
    "independent check": "J. Carpentier et al.: The Pinocchio C++ library, IEEE/SICE International Symposium on System "
    "Integration, 2019",
    "derivatives": "J. A. E. Andersson et al.: CasADi, a software framework for nonlinear optimization and optimal "
    "control, Mathematical Programming Computation 11, 2019",
    "posture": "C. Dumas, S. Caro, S. Garnier, B. Furet: Joint stiffness identification of six-revolute industrial "
    "serial robots, Robotics and Computer-Integrated Manufacturing 27(4), 2011",
}
#: The program itself.
PROGRAM = "The compplan developers: compplan, offline path compensation for industrial robots, version {version}"
#: Strategies that solve for derivatives.
WITH_DERIVATIVES = ("nlp",)


def list_citations(
    version: str, strategy: str, *, bends: bool, chosen_posture: bool, force_model: str | None, sources: Iterable[str]
) -> tuple[str, ...]:
    """List what to cite for a plan: the program, the methods that it used, the sources of the robot's numbers."""
    used = ["timing", "independent check"]
    used += ["joint springs", "stiffness under load"] if bends else []
    used += ["derivatives"] if strategy in WITH_DERIVATIVES else []
    used += ["posture"] if chosen_posture else []
    papers = [f"{name}: {text}" for name, text in METHODS.items() if name in used]
    force = "" if force_model is None else getattr(FORCE_MODELS[force_model], "cites", "")
    papers += [f"force model {force_model}: {force}"] if force else []
    return (PROGRAM.format(version=version), *papers, *(f"robot model: {text}" for text in sources))
