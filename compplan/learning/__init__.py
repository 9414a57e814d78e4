"""The loop: what to measure for a path, and what is learned from a cut part."""
