"""Studies that judge compplan from outside."""
