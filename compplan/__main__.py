"""Run the command line: python -m compplan."""

from compplan.cli import main

main()
