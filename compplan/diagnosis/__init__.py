"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.

    diagnosis = diagnose_campaign(robot, campaign, register=("base", "tool"))
    diagnosis.verdict.status, diagnosis.verdict.findings     what is named, how probable, ambiguous with what
    diagnosis.gap                                            before, after, held out, noise floor
    diagnosis.updated                                        the updated robot
    diagnosis.fit                                            everything else: `at`, normal equations, models

The method is Bayesian comparison of sets of effects over a background of small errors, with exact forward models. Five
packages, each of which reads those before it: `data` (residuals and their noise) -> `evidence` (inner products,
evidence) -> `search` (rounds of exact models) -> `validation` (what speaks against a claim, what poses left out say) ->
`results` (verdict, folder, where, what next). Each one's docstring says what comes in, what goes out and by which
equation.
"""

from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
from compplan.diagnosis.results.result import Candidate, Diagnosis, Gap
from compplan.diagnosis.results.verdict import Finding, Structure, Verdict

__all__ = ["Candidate", "Diagnosis", "Finding", "Gap", "Structure", "Verdict", "diagnose_campaign"]
