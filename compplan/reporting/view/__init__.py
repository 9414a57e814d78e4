"""Browser viewer of a result folder: recording, scenes of plain data, server."""
