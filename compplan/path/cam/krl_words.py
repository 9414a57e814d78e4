"""The words of KUKA KRL statements: what begins a move, an assignment, a block; positions and their numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.files.tables import Array
from compplan.path.cam.robot_moves import NUMBER, make_pose

ITEM = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER}|'[BH][0-9A-F]+')\s*(?:,|$)")
AGGREGATE = re.compile(r"\{\s*(?:[A-Z]\w*\s*:)?([^{}]*)\}")
ASSIGN = re.compile(
    r"(?:DECL\s+|GLOBAL\s+|CONST\s+)*(?:[A-Z]\w*\s+)?(\$?[A-Z][\w.]*(?:\[\d+\])?(?:\.\w+)?)\s*=\s*(.+)$"
)
#: What may follow a position: approximation.
ENDING = re.compile(r"(\s*C_[A-Z]+|\s*CA\s.*)*\s*$")
OUTPUT = re.compile(r"(\$OUT\[\d+\])\s*=\s*(TRUE|FALSE)$")
WAITS = re.compile(rf"WAIT\s+SEC\s+({NUMBER})$")
#: Statements that a robot program of another language cannot repeat: the operator is asked.
ASKED = re.compile(r"WAIT\b|PULSE\b|TRIGGER\b|\$A?N?OUT|ANOUT\b")
MOTION = re.compile(r"(S?LIN|S?CIRC|S?PTP|SPL|SPLINE|ENDSPLINE|LIN_REL|PTP_REL|CIRC_REL|S\w+_REL)\b")
OPENS = re.compile(r"(IF|FOR|WHILE|LOOP|REPEAT|SWITCH)\b")
CLOSES = re.compile(r"(ENDIF|ENDFOR|ENDWHILE|ENDLOOP|UNTIL|ENDSWITCH)\b")
CALL = re.compile(r"([A-Z_]\w{0,60})\s*\((.*)\)\s*$")
HEAD = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\(")
BAS = re.compile(r"BAS\s*\(\s*#(\w+)\s*,\s*([^)]*)\)")
PLACE, ANGLES, AXES = ("X", "Y", "Z"), ("A", "B", "C"), tuple(f"A{number}" for number in range(1, 7))
EXTERNAL = tuple(f"E{number}" for number in range(1, 7))
#: Statements that say nothing about the path.
SILENT = re.compile(
    r"DECL|INT|REAL|BOOL|CHAR|EXT|INTERRUPT|GLOBAL|WAIT|HALT|CONTINUE|TRIGGER|SIGNAL|RETURN|BRAKE|PULSE|ENDFCT|ENUM|STRUC|"
    r"DEFDAT|ENDDAT|ANOUT|ANIN|CASE|DEFAULT|ELSE|IMPORT|RESUME|CREAD|CWRITE|COPEN|CCLOSE|E6POS|E6AXIS|FRAME|POS|AXIS|"
    r"CHANNEL|CONFIRM|FDAT|LDAT|PDAT|ON_ERROR_PROCEED|TIME_BLOCK|CONST_VEL"
)


def split_positions(text: str) -> list[str]:
    """Split the arguments of a move at commas outside of braces."""
    parts, depth, start = [], 0, 0
    for index, letter in enumerate(text):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            parts.append(text[start:index])
            start = index + 1
    return [*parts, text[start:]]


def clean_line(raw: str) -> str:
    """Return a statement in capitals, without its comment."""
    text = raw.partition(";")[0].strip()
    return "" if text.startswith("&") else text.upper()


def read_pose(numbers: Mapping[str, float]) -> Array:
    """Return the pose of X Y Z A B C: R = Rz(A) Ry(B) Rx(C)."""
    rotation = Rotation.from_euler("ZYX", [numbers[key] for key in ANGLES], degrees=True).as_matrix()
    return make_pose(np.array([numbers[key] for key in PLACE]), rotation)
