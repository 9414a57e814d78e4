"""Known: the uncertainty of a robot, and what that does to its tip.

`robot_uncertainty(robot)` answers with the folder's file, or with widths assumed by its grade (`assumed`). It is an
`Uncertainty` (`compplan.robot.uncertainty`); its `spread`, `width`, `covariance` and `smooth` carry the factor from
poses that the fit never saw, which is multiplied there and nowhere else. From it come robots that might be the true
one (`vary`: exactly) and the motion of the tip per parameter along a path (`slopes`).
"""
