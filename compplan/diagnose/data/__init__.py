"""Data: what was measured, as numbers that a model can be held against.

In: a robot, a log, what the robot should do at its rows (`compplan.effects.scene`). Out: channels (position,
orientation, encoders) of residuals r = measured - expected with their noise, sigma of the instrument and what a stay
shares (`channels`, `noise`); rows that no model of a robot explains (`outliers`); conventions by which a reading is
counted otherwise, and questions that a log raises before anything is fitted (`conventions`, `questions`).
"""
