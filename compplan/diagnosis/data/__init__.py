"""Data: measurements as residuals with noise, and what is odd about a log before any fit.

In base axes a row leaves r = T_base^-1 p_measured - p_expected = model error + stay + reading, stay ~ N(0, s) the
repeatability, reading ~ N(0, v) the instrument, so that the mean of n rows of a stay has the variance s + v / n.
"""
