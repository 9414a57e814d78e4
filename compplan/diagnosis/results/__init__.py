"""Results: names, robot folder, shares of the gap and further measurements, from a fit and its validated claims.

The uncertainty of a robot is S + m m^T, S the posterior covariance of its parameters, m the mean of those not in the
folder, and an unexplained error, both scaled so that 95 % bands cover that share of the held-out poses.
"""
