"""Labelled measurement campaigns drawn from the published formats alone.

Robots are the shipped folders, read and brought to rest by `benchmarks.simulated_robot`; effects, everyday errors and
labels are this package's own. Nothing of compplan or of `benchmarks.campaigns` is imported, so that a misunderstanding
which those two share shows. What is drawn: CONVENTIONS.md.
"""
