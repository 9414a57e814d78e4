"""Writers of the commands' output folders."""
