"""The continuous part of a plan: one nonlinear program, its solution at every waypoint, and its timing.

`problem` states it, `nlp` builds and solves it in CasADi, `limits` and `costs` hold one small class each, `dense` takes
the solution from the stations to every waypoint, `timing` runs the path by TOPP-RA.
"""
