"""Robust least squares of measured rows.

Input: residuals r, derivatives A and stated deviations. Equation: (A^T W A) dp = A^T W r, W from the noise estimated
by the residuals, block by block, and from a robust loss (`least_squares`). Output: identifiable parameters, covariance
and degrees of freedom, and the prediction of rows left out of the fit (`intervals`).
"""
