"""A plain rival of the diagnosis: least squares with the whole vocabulary, greedy by BIC, nothing of compplan in it."""
