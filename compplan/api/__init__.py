"""The verbs of `import compplan`: one a daily way from files, arrays or DataFrames to a result; they load it lazily."""
