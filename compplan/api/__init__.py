"""Functions of `import compplan` for daily tasks, from files, arrays or DataFrames to a result; loaded lazily."""
