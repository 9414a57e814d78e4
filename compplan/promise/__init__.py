"""The promise: how far the true tip may be from where a plan puts it, by how surely the robot is known."""
