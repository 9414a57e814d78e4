"""The path that the tool shall take: toolpaths, their generators and CAM readers, process wrenches."""
