"""Readers of further languages; see `compplan.controllers.readback`."""

from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript

__all__ = ["read_inform", "read_kawasaki", "read_sinumerik", "read_urscript"]
