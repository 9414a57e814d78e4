"""Validation: how probable a claim is, and how far models carry on poses that they never saw.

In: a fit.

Every claim is scored again among errors that no effect makes, smooth functions f of place, load, time and joints with
an unknown size (`unmodelled_causes`),

    margin = score(M with f) - log sum over rivals k exp(score(M without the claim, with k and f))

and its log odds are a logistic map of three features that was fitted to campaigns of known truth
(`calibrated_probability`),

    log p / (1 - p) = c + w . (arsinh(margin / 5), -log likeness, log motion)

the second from what is left along the claim's own motion, the third in noise floors. Which other effects the log cannot
tell from it, by the squares that they leave of its trace, says `ambiguity`; what no robot can have, `bounds`.

`held_out` deals poses to folds, `options` fits each model without every fold, among them the sparse Bayesian
calibration of `sparse`, and `stacking` mixes them with the weights that predict left-out poses best.

Out: for every claim its evidence, probability, rivals and breaches; residuals of poses never seen.
"""
