"""Labelled measurement campaigns drawn from the published formats alone.

Imports nothing of compplan or of `benchmarks.campaigns`: robots, statics, effects and labels are its own, so that a
misunderstanding which those two share shows. What is drawn, and how labels are made: CONVENTIONS.md.
"""
