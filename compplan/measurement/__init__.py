"""Measurements under load: measurement log and registration of its frames."""
