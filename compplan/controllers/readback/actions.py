"""What programs do beside motion, as each language's manual writes it; lines become "@action arguments" for readers."""

from __future__ import annotations

import re

from compplan.controllers.readback.poses import NUMBER, Move

TEXT = r'"([^"]*)"'
#: Forms of each language, longest first: a pattern over whole lines (indentation aside), and the action it is.
FORMS: dict[str, list[tuple[str, str]]] = {
    "krl": [
        (rf"IF \$IN\[(\d+)\] THEN\n *MsgNotify\({TEXT}\)\n *HALT\nENDIF", r"@pause_if \1"),
        (rf"MsgNotify\({TEXT}\)\n *HALT", "@pause"),
        (r"\$OUT\[(\d+)\]=TRUE", r"@on \1"), (r"\$OUT\[(\d+)\]=FALSE", r"@off \1"),
        (rf"WAIT SEC ({NUMBER})", r"@wait \1"), (r"WAIT FOR \$IN\[(\d+)\]", r"@expect \1"),
        (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
    "rapid": [
        (rf"IF di(\d+)=1 THEN\n *TPWrite {TEXT};\n *Stop;\n *ENDIF", r"@pause_if \1"),
        (rf"TPWrite {TEXT};\n *Stop;", "@pause"), (r"SetDO do(\d+),1;", r"@on \1"), (r"SetDO do(\d+),0;", r"@off \1"),
        (rf"WaitTime ({NUMBER});", r"@wait \1"), (r"WaitDI di(\d+),1;", r"@expect \1"),
        (r"CHANGER (\d+);", r"@call \1"),
    ],
    "urscript": [
        (rf"if \(get_standard_digital_in\((\d+)\)\):\n *popup\({TEXT}, title=\"compplan\", blocking=True\)\n *end",
         r"@pause_if \1"),
        (rf"popup\({TEXT}, title=\"compplan\", blocking=True\)", "@pause"),
        (r"set_standard_digital_out\((\d+), True\)", r"@on \1"),
        (r"set_standard_digital_out\((\d+), False\)", r"@off \1"), (rf"sleep\(({NUMBER})\)", r"@wait \1"),
        (r"while \(not get_standard_digital_in\((\d+)\)\):\n *sync\(\)\n *end", r"@expect \1"),
        (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
    "inform": [
        (r"PAUSE IF IN#\((\d+)\)=ON", r"@pause_if \1"), (r"PAUSE", "@pause"), (r"DOUT OT#\((\d+)\) ON", r"@on \1"),
        (r"DOUT OT#\((\d+)\) OFF", r"@off \1"), (rf"TIMER T=({NUMBER})", r"@wait \1"),
        (r"WAIT IN#\((\d+)\)=ON", r"@expect \1"), (r"CALL JOB:CHANGER", "@call 7"),
    ],
    "kawasaki_as": [
        (rf"IF SIG\(100(\d)\) THEN\n *TYPE {TEXT}\n *PAUSE\n *END", r"@pause_if \1"),
        (rf"TYPE {TEXT}\n *PAUSE", "@pause"), (r"SIGNAL (\d+)", r"@on \1"), (r"SIGNAL -(\d+)", r"@off \1"),
        (rf"TWAIT ({NUMBER})", r"@wait \1"), (r"SWAIT 100(\d)", r"@expect \1"), (r"CALL changer\((\d+)\)", r"@call \1"),
    ],
    "fanuc_ls": [
        (r"IF DI\[(\d+)\]=OFF,JMP LBL\[(\d+)\] ;\n *\d+: *PAUSE ;\n *\d+: *LBL\[\2\]", r"@pause_if \1"),
        (r"PAUSE", "@pause"), (r"DO\[(\d+)\]=ON", r"@on \1"), (r"DO\[(\d+)\]=OFF", r"@off \1"),
        (rf"WAIT +({NUMBER})\(sec\)", r"@wait \1"), (r"WAIT DI\[(\d+)\]=ON", r"@expect \1"),
        (r"CALL CHANGER\((\d+)\)", r"@call \1"),
    ],
    "val3": [
        (rf"if diIn(\d+)==true\n *userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)\n *endIf", r"@pause_if \1"),
        (rf"userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)", "@pause"), (r"doOut(\d+)=true", r"@on \1"),
        (r"doOut(\d+)=false", r"@off \1"), (rf"delay\(({NUMBER})\)", r"@wait \1"),
        (r"wait\(diIn(\d+)==true\)", r"@expect \1"), (r"call CHANGER\((\d+)\)", r"@call \1"),
    ],
    "sinumerik": [
        (r"M0", "@pause"), (r"M1", "@pause_if 0"), (rf"G4 F({NUMBER})", r"@wait \1"), (r"M3(?: S(\d+))?", r"@cw \1"),
        (r"M4(?: S(\d+))?", r"@ccw \1"), (r"M5", "@stop"), (r"M8", "@flood"), (r"M7", "@mist"), (r"M9", "@dry"),
        (r"\$A_OUT\[(\d+)\]=1", r"@on \1"), (r"\$A_OUT\[(\d+)\]=0", r"@off \1"), (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
}  # fmt: skip


def mark_actions(text: str, language: str) -> str:
    """Return a program's text with its actions as lines "@action arguments"."""
    head, tail = (r"^( *\d+: *)", r" *;") if language == "fanuc_ls" else (r"^( *)", "")
    for pattern, action in FORMS[language]:
        shifted = re.sub(r"\\(\d)", lambda match: f"\\{int(match[1]) + 1}", action)
        pattern = re.sub(r"(?<!\\)\\2(?!\d)", r"\\3", pattern)
        text = re.sub(f"{head}{pattern}{tail}$", rf"\1{shifted}{' ;' if tail else ''}", text, flags=re.M)
    return text


def read_action(line: str) -> Move | None:
    """Return a line "@action arguments" as a move that is none; other lines are not."""
    words = line[1:].split()
    return Move("act", True, action=(words[0], *map(float, words[1:]))) if line.startswith("@") else None
