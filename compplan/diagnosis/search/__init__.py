"""Search: the set of effects that explains a log best, and the exact model with these effects.

A set of claims M is scored by

    score(M) = log p(y | M) + sum over claims (log prior odds of place and form + log probability of the size)

minus a penalty where claims move the target further than the whole gap and cancel each other. Claims are added,
exchanged and removed while the score rises by more than `WORTHWHILE` (`search`). The best set enters the exact forward
model by a step x + a (x_M - x), a halved until the exact model improves (`polish.descend`); the model is linearized
there and searched again until no observation moves by more than `SETTLED` of its noise (`fit`, `state`). Last, claims
held, the exact model is stepped until its residual is that of its linearization (`polish.polish_fit`).
"""
