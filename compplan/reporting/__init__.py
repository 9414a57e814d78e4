"""HTML reports, charts, setup sheets and output folders of the commands."""
