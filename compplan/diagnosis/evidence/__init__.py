"""Evidence: all that a log says about every signature, as inner products, and the evidence of any set of them.

In: channels of residuals y and signatures A of effects, prior deviation S. The equation: y = A S x + b + e with x
normal of unit variance, b the small errors everywhere (`candidates`), e the noise;

    log evidence = -1/2 (y^T K^-1 y + log det K),  K = N + A S^2 A^T

by a Cholesky factor of the smaller side (`likelihood`). N holds each channel's noise and an
error that the rows of a stay share; both, and the size of every class of small errors, are those of largest evidence. A
further signature of products G and g with what is left adds, at prior variance s^2,

    1/2 (s^2 g^2 / (1 + s^2 G) - log(1 + s^2 G))

averaged over the sizes s that it may have (`evidence_gain`).

Out: posterior and evidence of a set of signatures (`evidence`), and what each further one would add. `candidates` lists
the signatures of effects, `proposals` waves and shifts at the periods and rows that what is left suggests, as far as
their gain beats the best of as many in pure noise; `unmodelled` dependences that no effect makes.
"""
