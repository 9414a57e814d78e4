"""Readback of native robot programs: interpreters that are independent of the writers."""
