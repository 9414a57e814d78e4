"""Elastostatics of a serial arm: chain, loaded equilibrium, derivatives, stiffness, encoders, inverse kinematics."""
