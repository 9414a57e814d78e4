"""Search: which effects together explain a log best, and the exact robot that they make.

In: a ledger. Claims are added, exchanged and dropped while evidence plus log prior rises (`search`, a second start in
`restart`); the best set is put into the exact forward model, linearized there and searched again until nothing moves by
more than a tenth of its noise (`fit`, steps by `descent`, where a fit stands by `state`, frames by `polish`). Out: a
fit.
"""
