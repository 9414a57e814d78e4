"""Reading and writing text files: tables, columns with units, TOML."""
