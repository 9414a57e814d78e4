"""The loop: what to measure for a path, what a cut part teaches, and a certificate of how the robot stands."""
