"""A robot folder in MuJoCo, read and brought to rest by code that shares nothing with compplan."""
