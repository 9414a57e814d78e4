"""Search: the set of effects that explains a log best, and the exact model with these effects.

A set of claims (selected effects) is scored by log evidence, log prior odds of place and form, and log probability of
the sizes. Claims are added, exchanged and removed while the score rises by more than `SEARCH.least_gain`. The best set
enters the exact forward model, which is linearized and searched again until no observation moves by more than
`SEARCH.tolerance` of its noise.
"""
