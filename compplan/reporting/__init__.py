"""Pages and pictures: what was computed, shown so that an engineer can judge it."""
