"""Which poses to measure: one way to draw them, one account of what they tell, one exchange; the aim is the caller's.

In: a robot and what is to be known better. `pool` draws postures that the arm can take, `information` says what rows of
derivatives H with noise R take off a covariance S,

    S - S H^T (H S H^T + R)^-1 H S,

and `exchange` takes the best of many, greedily, then one for one. The loop asks for the variance of the tip along a
path, the diagnosis for the odds of two explanations.
"""
