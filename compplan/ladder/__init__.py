"""The ladder graph: configuration, rotation about the tool axis, extra axes and lean along a path."""
