"""Studies that judge compplan from outside, sorted by what they ask.

Each is run by `python -m benchmarks NAME` (`--help`, or its first lines, say what it takes); `python -m benchmarks`
lists them. A page of figures is written by `python -m benchmarks results NAME`, which runs what it needs.
"""

from __future__ import annotations

#: What can be run, by the question that it asks.
QUESTIONS: dict[str, tuple[str, ...]] = {
    "Does the tip go where the plan says?": ("coverage", "coverage.touched", "limits", "nlp", "planted"),
    "Is a program read as the controller would read it?": ("reading",),
    "Is the force right?": ("engagement",),
    "Is the cause found?": ("outsider", "diagnosis", "rival", "ablation"),
    "Do measuring and learning make the next part better?": ("loop", "ladder", "shop"),
    "Does it bear bad files?": ("bad_inputs", "bad_inputs.cam_mutants"),
    "What is written from all this?": ("results",),
}
