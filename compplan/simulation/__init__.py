"""Simulated robots: actual motion for a command, computed without the planner's code."""
