"""Evidence: inner products of all signatures with a log, and the evidence of any set of them.

With residuals y, signatures A of effects of prior deviation S, y = A S x + b + e, x normal of unit variance, b small
errors everywhere, e the noise: log evidence = -1/2 (y^T K^-1 y + log det K), K = N + A S^2 A^T. A further signature of
products G and g with the residual adds 1/2 (s^2 g^2 / (1 + s^2 G) - log(1 + s^2 G)) at prior variance s^2, averaged
over its possible sizes s.
"""
