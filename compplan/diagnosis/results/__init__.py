"""Results: names, robot folder, shares of the gap and further measurements, from a fit and its validated claims.

A robot is known to within S + m m^T about the folder, S the posterior covariance of its parameters, m the mean that the
folder lacks, and an unexplained error, both scaled so that 95 % bands hold that share of the poses left out.
"""
