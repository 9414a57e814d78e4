"""Parameter uncertainty of a robot, and the resulting uncertainty of its tip.

`robot_uncertainty(robot)` returns the `Uncertainty` (`compplan.robot.uncertainty`) of the folder's file, or standard
deviations assumed by the folder's grade (`assumed`). `spread`, `width`, `covariance` and `smooth` of it include the
calibration factor from poses left out of the fit, which is applied nowhere else. `sensitivities` varies the robot model
exactly and differentiates the tip along a path; `band` computes the 95 % band.
"""
