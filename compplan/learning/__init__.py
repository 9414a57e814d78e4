"""The measuring loop: design of measurements for a path, and model update from a cut part."""
