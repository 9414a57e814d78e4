"""Least squares of measured rows, whatever they measure: weights, robust losses, spread, rows left out.

In: residuals r, derivatives A and stated deviations (`system`). The equation: (A^T W A) dp = A^T W r, W of the noise
that the residuals show, block by block, and of a loss that gross outliers cannot pull far (`robust`), step by step
(`settle`). Rows of other instruments than a tracker tell one number, or the distance of contacts (`sighted`). Out:
which parameters the rows tell apart (`separable`), covariance and degrees of freedom, from groups of neighbours where
residuals agree (`spread`), and what a fit says of rows that it never saw (`heldout`).
"""
