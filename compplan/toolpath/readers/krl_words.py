"""The words of KUKA KRL statements: what begins a move, an assignment, a block; positions and their numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from compplan.io.tables import Array
from compplan.toolpath.readers.robot_moves import NUMBER

ITEM = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER}|'[BH][0-9A-F]+')\s*(?:,|$)")
AGGREGATE = re.compile(r"\{\s*(?:[A-Z]\w*\s*:)?([^{}]*)\}")
ASSIGN = re.compile(
    r"(?:DECL\s+|GLOBAL\s+|CONST\s+)*(?:[A-Z]\w*\s+)?(\$?[A-Z][\w.]*(?:\[\s*\d+\s*\])?(?:\.\w+)?)\s*=\s*(.+)$"
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
#: A loop whose bounds are numbers.
FOR = re.compile(r"FOR\s+([A-Z]\w*)\s*=\s*([-+]?\d+)\s+TO\s+([-+]?\d+)(?:\s+STEP\s+([-+]?\d+))?\s*$")
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


def clean_line(raw: str) -> str:
    """Return a statement in capitals, without its comment."""
    text = raw.partition(";")[0].strip()
    return "" if text.startswith("&") else text.upper()


def read_pose(numbers: Mapping[str, float]) -> Array:
    """Return the pose of X Y Z A B C: R = Rz(A) Ry(B) Rx(C)."""
    a, b, c = (math.radians(numbers[key]) for key in ANGLES)
    sa, ca, sb, cb, sc, cc = math.sin(a), math.cos(a), math.sin(b), math.cos(b), math.sin(c), math.cos(c)
    return np.array([
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc, numbers["X"]],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc, numbers["Y"]],
        [-sb, cb * sc, cb * cc, numbers["Z"]],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip
