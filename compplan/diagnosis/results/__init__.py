"""Results: names, robot folders, shares of the gap and further measurements, from a fit and its validated claims.

A delivered robot is known to within the posterior of its parameters, those it does not hold included,

    S + m m^T about the folder,   S the posterior covariance, m the mean that the folder lacks

and an unexplained error with a length scale, both scaled so that bands of 95 % hold that share of the poses left out
(`posterior`; `calibration` lists values for controllers). A folder is delivered where it predicts poses left out better
than the nominal robot by more than chance (`delivery`). The gap is divided among the motions g_i of the posterior by
g_i . (g_i + 2 rest) / |gap|^2, which sum to what is explained (`shares`, `small_errors`). A further measurement is
rated by the expected rise of the probability of the true one of two explanations (`next_measurement`).

`verdict` names effects with probabilities, `accuracy` states pose accuracy and learning curve, `where` and `traces`
show where the gap lies; `result` holds all.
"""
