"""Nominal toolpaths: their generators, CAM readers, corner rounding and contact of the process."""
