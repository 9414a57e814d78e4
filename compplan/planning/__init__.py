"""Planning: a nonlinear program of the correction, its solution at every waypoint, and the timing.

`problem` defines the program, `nlp` builds and solves it in CasADi, `limits` and `costs` hold one small class each,
`dense` refines the solution of the stations at every waypoint, `timing` computes the timing by TOPP-RA.
"""
