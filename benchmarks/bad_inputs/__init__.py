"""Bad inputs: tables of faults put into one good workspace, and what compplan answers to each."""
