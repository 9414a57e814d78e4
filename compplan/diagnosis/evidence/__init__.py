"""Evidence: inner products of all signatures with a log, and the evidence of any set of them.

With residuals y, signatures A of effects of prior deviation S, y = A S x + b + e, x normal of unit variance, b small
errors everywhere (`candidates`), e the noise,

    log evidence = -1/2 (y^T K^-1 y + log det K),  K = N + A S^2 A^T

by a Cholesky factor of the smaller side (`likelihood`). N holds the noise of each channel and an error that the rows
of a stay share; both, and the size of every class of small errors, are those of largest evidence. A further signature
of products G and g with the residual adds, at prior variance s^2,

    1/2 (s^2 g^2 / (1 + s^2 G) - log(1 + s^2 G))

averaged over its possible sizes s (`evidence_gain`). `candidates` lists the signatures of effects, `proposals` waves
and shifts at periods and rows found in the residual where their gain beats the best of as many in pure noise, and
`unmodelled` errors that no effect makes.
"""
