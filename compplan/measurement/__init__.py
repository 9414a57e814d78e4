"""Measurements under load: the campaign log and its registration."""
