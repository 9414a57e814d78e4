"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.

    diagnosis = diagnose_campaign(robot, campaign, register=("base", "tool"))
    diagnosis.verdict.status, diagnosis.verdict.findings     what is named, how probable, ambiguous with what
    diagnosis.gap                                            before, after, held out, noise floor
    diagnosis.updated                                        the updated robot
    diagnosis.fit                                            everything else: linearization `at`, ledger, models

The method is Bayesian comparison of sets of effects over a background of small errors, with exact forward models:
`channels` and `noise` (observations) -> `ledger` (inner products) -> `evidence` -> `search` -> `fit` (rounds of exact
models, each step as far as `descent` lets it) -> `doubt` (the same beside errors that no effect makes) ->
`repetition`, `ambiguity`, `certainty`, `verdict` -> `held_out` -> `result`.
"""

from compplan.diagnose.campaign_diagnosis import diagnose_campaign
from compplan.diagnose.result import Candidate, Diagnosis, Gap
from compplan.diagnose.verdict import Finding, Structure, Verdict

__all__ = ["Candidate", "Diagnosis", "Finding", "Gap", "Structure", "Verdict", "diagnose_campaign"]
