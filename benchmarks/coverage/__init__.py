"""Does the 95 % band hold on arms in motion? Drawn jobs, drawn true arms in MuJoCo, claim beside truth.

It imports nothing of compplan: readers and bodies are those of `benchmarks.simulated_robot`, the draws follow the
widths that docs/robots.md and the pages state; plans come from the command line.
"""
