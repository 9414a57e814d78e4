"""Doubt: what speaks against a claim.

In: a fit. Out, claim by claim: how it stands beside errors that no effect makes (`doubt`), how often it is met again in
halves of the log (`repetition`), how well causes without a name imitate it (`imitation`), how alike left-over and claim
are (`likeness`, `gears`), which other effects the log cannot tell from it (`ambiguity`), what no robot can have
(`bounds`); one number for it, a logistic map of these that was fitted to campaigns of known truth (`certainty`). And
how far models carry on poses that they never saw: `held_out`, `options`, `blend`.
"""
