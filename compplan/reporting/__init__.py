"""Pages and pictures: what was computed, shown so that an engineer can judge it."""

from compplan.reporting.page import (
    Chart,
    Column,
    Columns,
    Fold,
    PageTable,
    Picture,
    Provenance,
    Section,
    TableCell,
    render_page,
    write_page,
)
from compplan.reporting.provenance import describe_grade, describe_robot
from compplan.reporting.robot_scene import draw_robot, frame_scene, locate_links, place_shapes
from compplan.reporting.thinning import simplify_path, thin_path, thin_rows

__all__ = [
    "Chart",
    "Column",
    "Columns",
    "Fold",
    "PageTable",
    "Picture",
    "Provenance",
    "Section",
    "TableCell",
    "describe_grade",
    "describe_robot",
    "draw_robot",
    "frame_scene",
    "locate_links",
    "place_shapes",
    "render_page",
    "simplify_path",
    "thin_path",
    "thin_rows",
    "write_page",
]
