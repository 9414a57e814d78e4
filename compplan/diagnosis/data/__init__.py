"""Data: what was measured, as numbers that a model can be held against.

In: a robot, a log, what the robot should do at its rows (`compplan.effects.forward_model`).

The equation: in base axes a row leaves r = T_base^-1 p_measured - p_expected, and with the instrument's variance v, the
repeatability s of a stay and n rows in it

    r = model error + stay + reading,   stay ~ N(0, s),   reading ~ N(0, v),   mean of a stay ~ N(0, s + v / n)

v and s are estimated from rows repeated in a stay, poses met again, the roughness of paths and what log and folder
state, each with its degrees of freedom (`noise`).

Out: channels (position, orientation, encoders, known distances) of residuals with that noise, rows of a stay in one
group (`channels`); rows that no model of a robot explains (`outliers`); conventions by which a reading is counted
otherwise (`conventions`), and questions that a log raises before anything is fitted (`questions`, `signs`). What more
than one room means by "enough", "sure" or "by chance" stands in `agreed`.
"""
