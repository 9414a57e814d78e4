"""A folder of results in a browser: what it holds (`recording`), scenes of plain data, a server that shows them."""
