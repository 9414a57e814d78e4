"""Results: what is said and delivered.

In: a fit and what speaks against its claims.

The equation: what goes out is known to within the posterior of its parameters, those it does not hold included,

    S + m m^T about the folder,   S the posterior covariance, m the mean that the folder lacks

and an error u of a length scale on top that no parameter explains, both widened by the factor that makes 95 % of the
poses left out lie in their bands (`posterior`, `calibration` for what a controller takes). A folder goes out where it
predicts poses never seen better than the nominal robot, by more than luck: p(gains' signs by chance) < 1 - `SURE`
(`delivery`). The gap is divided among the parts g_i of the posterior's motion by g_i . (g_i + 2 rest) / |gap|^2, which
sum to what is explained (`shares`, `small_errors`). A further measurement is worth the rise of the probability of the
true one of two explanations that it is expected to bring (`next_measurement`, `measurement_moves`).

Out: names with probabilities (`verdict`, `explanations`), the robot folder and how surely it is known, how
accurate it is and what more poses would bring (`accuracy`), where the gap lies (`where`, `gap_tables`,
`traces`), what to measure next. `result` holds all.
"""
