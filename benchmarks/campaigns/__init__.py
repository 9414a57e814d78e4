"""Simulated measurement campaigns with known effects, made by MuJoCo and independent of the product."""
