"""What a controller makes of a program: blends, speed along the path, drives that lag; and what a log says of it."""
