"""Posture along a path: configuration, spin, extra axes, placement of the part, clearance."""
