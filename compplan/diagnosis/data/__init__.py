"""Data: residuals with their noise, and plausibility checks of a log before any fit.

In base axes a row has r = T_base^-1 p_measured - p_expected = model error + stay + reading. A stay is a series of rows
without robot motion: repeatability, N(0, s). The reading is N(0, v) of the instrument. Means of n rows have s + v / n.
"""
