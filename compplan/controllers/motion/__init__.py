"""Execution of a program by a controller: blends, speed along the path, lag of drives; identification from logs."""
