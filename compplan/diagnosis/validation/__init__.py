"""Doubt: what speaks against a claim.

In: a fit.

The equation: every claim is scored again among errors that no effect makes, smooth functions f of place, load, time and
joints with an unknown size (`doubt`),

    margin = score(M with f) - log sum over rivals k exp(score(M without the claim, with k and f))

and its log odds are a logistic map of four features x that was fitted to campaigns of known truth (`certainty`),

    log p / (1 - p) = c + w . (arsinh(margin / 5), share of halves that repeat it, -log imitated, -log likeness)

the last three from halves of the log (`repetition`), drawn causes without a name (`imitation`), and what is left along
the claim's own motion (`likeness`). Whether several waves are a gear's says `gears`; which other effects the log cannot
tell from it, by the squares that they leave of its trace, `ambiguity`; what no robot can have, `bounds`.

How far models carry on poses that they never saw: `held_out` deals poses to folds, `options` fits each model without
every fold, `blend` mixes them with the weights that predict left-out poses best.

Out: for every claim its evidence, probability, rivals and breaches; residuals of poses never seen.
"""
