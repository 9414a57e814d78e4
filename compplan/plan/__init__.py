"""From a task to a corrected command: the nonlinear program, strategies, feed, timing, evaluation."""
