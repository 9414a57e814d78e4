"""Validation: how probable a claimed effect is, and how well models predict poses that they were not fitted to.

Every claim is scored again among errors that no effect makes (`unmodelled`). Its log odds are a logistic map
c + w . (arsinh(margin / 5), -log spurious-fit probability, -log residual similarity) (`probability`).
"""
