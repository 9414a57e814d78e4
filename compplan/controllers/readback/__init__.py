"""Native robot programs read back, each as its controller would run it; they share nothing with the writers."""
