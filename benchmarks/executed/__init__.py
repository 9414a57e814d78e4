"""Programs as a drawn controller executes them, by someone who has not read how compplan models one.

No module here imports compplan. What is drawn, and from which published descriptions: `benchmarks.executed.controller`.
"""
