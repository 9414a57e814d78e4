"""Readers of further languages; see `compplan.second.programs`."""

from compplan.second.programs.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript

__all__ = ["read_inform", "read_kawasaki", "read_sinumerik", "read_urscript"]
