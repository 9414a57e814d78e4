"""The loop: what to measure for a path, and what a cut part teaches."""
