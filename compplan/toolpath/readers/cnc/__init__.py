"""Interpretation of CNC programs: lexers, one interpreter of modal state, and a table of operations per dialect."""
