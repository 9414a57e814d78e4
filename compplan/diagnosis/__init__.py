"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.

    diagnosis = diagnose_campaign(robot, campaign, register=("base", "tool"))
    diagnosis.verdict.status, diagnosis.verdict.findings     named effects, their probability, ambiguities
    diagnosis.gap                                            before, after, held out, noise floor
    diagnosis.updated                                        the updated robot
    diagnosis.fit                                            linearization `at`, normal equations, models

The method is Bayesian comparison of sets of effects over a background of small errors, with exact forward models. Five
packages, each of which imports those before it: `data` (residuals and their noise) -> `evidence` (inner products,
evidence) -> `search` (rounds of exact models) -> `validation` (probability of effects, held-out poses) -> `results`
(verdict, robot folder, location of the gap, next measurements). Each package docstring states input, output and
equation.
"""

from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
from compplan.diagnosis.results.result import Candidate, Diagnosis, Gap
from compplan.diagnosis.results.verdict import Finding, Structure, Verdict

__all__ = ["Candidate", "Diagnosis", "Finding", "Gap", "Structure", "Verdict", "diagnose_campaign"]
