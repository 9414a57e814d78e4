"""Data: measurements as residuals with noise, for any model of the robot.

In base axes a row leaves r = T_base^-1 p_measured - p_expected. With the instrument's variance v, the repeatability s
of a stay and n rows in it,

    r = model error + stay + reading,   stay ~ N(0, s),   reading ~ N(0, v),   mean of a stay ~ N(0, s + v / n)

v and s are estimated from rows repeated in a stay, poses met again, the roughness of paths and what log and folder
state, each with its degrees of freedom (`noise`, which also finds outliers).

`channels` holds residuals (position, orientation, encoders, known distances) with that noise, rows of a stay in one
group. `conventions` finds joints that are counted otherwise, `plausibility` and `signs` check the log before any fit,
`shared` holds numbers that several packages use.
"""
