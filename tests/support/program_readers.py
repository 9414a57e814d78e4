"""Readers of programs that share nothing with the writers; see `compplan.controllers.readback`."""

from compplan.controllers.readback.fanuc_abb import read_csv, read_fanuc, read_rapid
from compplan.controllers.readback.kuka_staubli import read_krl, read_val3

__all__ = ["read_csv", "read_fanuc", "read_krl", "read_rapid", "read_val3"]
