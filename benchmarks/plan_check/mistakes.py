"""Mistakes that are planted in the product from outside: a plan made with one must not be called solved.

Each is a few lines run in the process of the command before it starts. They replace a function by name in every module
that holds it, wherever it lives; one that is not there ends the run with exit status 1, so that no mistake is missed
silently.
"""

from __future__ import annotations

PLANT = """
import dataclasses, importlib, pkgutil, sys
import compplan
for found in pkgutil.walk_packages(compplan.__path__, "compplan."):
    if not found.name.endswith("__main__"):
        try:
            importlib.import_module(found.name)
        except ImportError:
            pass
def replace_function(name, wrap):
    modules = [module for key, module in list(sys.modules.items()) if key.startswith("compplan")]
    homes = [module for module in modules if callable(getattr(module, name, None))]
    assert homes, "the mistake cannot be planted: compplan has no " + name
    mistaken = wrap(getattr(homes[0], name))
    for module in homes:
        setattr(module, name, mistaken)
"""

#: Name of the job, what is wrong, and how it is brought about.
MISTAKES = {
    "mistake_none": ("no mistake", ""),
    "mistake_sign": (
        "the sign of every compliance turned round in the planner's chain, the judge's robot untouched",
        """
def flip(chain):
    return dataclasses.replace(chain, compliance=-chain.compliance)
replace_function("build_chain", lambda honest: lambda *rest, **options: flip(honest(*rest, **options)))
""",
    ),
    "mistake_springs": (
        "every compliance doubled as the robot folder is read",
        """
replace_function("read_robot_folder", lambda honest: lambda folder: honest(folder).scale_compliance(2.0))
""",
    ),
    "mistake_tool": (
        "the tool mounted with its x turned round",
        """
import numpy as np
homes = {c for m in list(sys.modules.values()) if getattr(m, "__name__", "").startswith("compplan")
         for c in vars(m).values() if isinstance(c, type) and "with_tool" in vars(c)}
assert homes, "the mistake cannot be planted: compplan has no with_tool"
for home in homes:
    def mistaken(self, pose, *rest, _honest=home.with_tool, **options):
        turned = np.array(pose, float)
        turned[0, 3] = -turned[0, 3]
        return _honest(self, turned, *rest, **options)
    home.with_tool = mistaken
""",
    ),
    "mistake_wrench": (
        "forces to the left taken for forces to the right",
        """
import numpy as np
replace_function("predict_wrench", lambda honest: lambda *rest, **options: honest(*rest, **options)
                 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0]))
""",
    ),
}


def mistake_of(job: str) -> str:
    """Return what has to run before the command, or nothing."""
    text = MISTAKES.get(job, ("", ""))[1]
    return PLANT + text if text else ""
