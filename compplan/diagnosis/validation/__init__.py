"""Validation: how probable a claimed effect is, and how well models predict poses that they were not fitted to.

Every claim is scored again among errors that no effect makes, smooth functions f of place, load, time and joints with
an unknown size (`unmodelled_causes`),

    margin = score(M with f) - log sum over alternatives k exp(score(M without the claim, with k and f))

and its log odds are a logistic map of three features, fitted to campaigns of known truth (`calibrated_probability`),

    log p / (1 - p) = c + w . (arsinh(margin / 5), -log spurious-fit probability, -log residual similarity).

`spurious_fit` draws errors outside the vocabulary, `ambiguity` finds effects that the campaign cannot distinguish from
a claim, `bounds` lists sizes that no robot can have.

`held_out` deals poses to folds, `options` fits each candidate model without each fold, among them the sparse Bayesian
calibration of `sparse`, and `stacking` mixes them with the weights of least error on the poses left out.
"""
