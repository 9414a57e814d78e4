"""Answer: what is said and delivered.

In: a fit and what speaks against its claims. Out: names with probabilities (`verdict`), the robot folder that is
written and how surely it is known, S + m m^T about the folder (`delivery`, `posterior`, `explanations`); how far it
carries along paths (`accuracy`, `calibration`, `assessment`); where the gap comes from, divided among the same
signatures that name it (`where`, `shares`, `small_errors`, `traces`, `gap_tables`); what to measure next
(`next_measurement`). `result` holds all.
"""
