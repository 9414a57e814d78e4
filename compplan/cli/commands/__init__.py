"""Commands of the command line, by subject: each is a click command `run_NAME`."""
