"""compplan: make industrial robots cut where the CAM says."""

__version__ = "0.1.0"
