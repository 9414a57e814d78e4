"""CNC programs: a lexer, one interpreter of modal state, and a table a dialect that maps words to operations."""
