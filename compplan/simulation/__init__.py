"""The virtual cell: what a robot really does with a command, computed without the planner's code."""
