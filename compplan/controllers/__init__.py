"""Robot controllers: native programs, their read-back, and how a controller executes them."""
