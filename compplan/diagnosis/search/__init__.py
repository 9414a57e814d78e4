"""Search: which effects together explain a log best, and the exact robot that they make.

In: normal equations, linearized at a robot x.

The equation: a set of claims M is scored by

    score(M) = log p(y | M) + sum over claims (log prior odds of place and form + log probability of the size)

minus a price where claims move the target further than the whole gap and cancel each other. Claims are added,
exchanged, merged and dropped while the score rises by more than `WORTHWHILE` (`search`). The best set is put into the
exact forward model by a step x + a (x_M - x), a halved until the exact model gains (`polish.descend`), linearized there
and searched again until no observation moves by more than `SETTLED` of its noise (`fit`; where a fit stands is
`state`). Last, claims held, the exact model is stepped until it leaves no more than its linearization promises
(`polish.polish_fit`).

Out: a fit: claims, parameters, frames, noise, outliers, and every model that was looked at.
"""
