"""Validation: calibrated probability of a claimed effect, and errors of models on held-out poses.

Every claim is re-evaluated together with unmodelled errors (`unmodelled`). Its log odds are a logistic map c + w .
(arsinh(margin / 5), -log residual similarity) (`probability`). Effects alike that the campaign
distinguishes from it share the probability by their evidence.
"""
