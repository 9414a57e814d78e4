"""Least squares of measured rows, whatever they measure.

In: residuals r, derivatives A and stated deviations. The equation: (A^T W A) dp = A^T W r, W of the noise that the
residuals show, block by block, and of a loss that gross outliers cannot pull far (`least_squares`). Out: which
parameters the rows tell apart, covariance and degrees of freedom, and what a fit says of rows left out (`intervals`).
"""
