"""Ledger: all that a log says about every signature, as inner products, and the evidence of any set of them.

In: channels of residuals y and signatures A of effects, prior deviation S. The equation: y = A S x + b + e with x
normal of unit variance, b the small errors everywhere (`background`), e the noise;

    log evidence = -1/2 (y^T K^-1 y + log det K),  K = N + A S^2 A^T

by a Cholesky factor of the smaller side (`few_rows`, `many_rows`, `cholesky`). Out: posterior and evidence of a set of
signatures (`evidence`), and what each further one would add (`gains`); `offers` and `proposals` list the signatures,
`unmodelled` those that no effect makes.
"""
