"""Transform Heidenhain, Sinumerik, APT, KRL and RAPID programs in plain text so that the path stays the same."""

from __future__ import annotations

import random
import re

KLARTEXT = re.compile(r"\d+ +(.*)")
PLAIN_LINE = re.compile(r"(\d+ +)?L( [XYZ][-+]?[\d.]+)+( R0)?( F\d+)?( FMAX)?$")
SINUMERIK_WORD = re.compile(r"([A-Z])([-+]?\d+\.?\d*|=\(?[-+]?\d+\.?\d*\)?)$|([A-Z]+\d*=[-+]?[\d.]+)$")


def add_klartext_comments(text: str) -> str:
    """Put remarks behind the blocks of a Heidenhain program, and lines of their own between them."""
    lines = []
    for line in text.splitlines():
        lines.append(line)
        if re.match(r"\d+ +L ", line):
            lines[-1] = f"{line} ; a remark"
            lines.append("; L X+99 Y+99 FMAX")
    return "\n".join(lines) + "\n"


def find_klartext_run(text: str) -> tuple[list[str], list[str], list[str]] | None:
    """Find a run of straight blocks of a Heidenhain program: before, run, after; block numbers are dropped."""
    lines = [m[1] if (m := KLARTEXT.match(line)) else line for line in text.splitlines()]
    best, run = (0, 0), 0
    for k, line in enumerate(lines):
        run = run + 1 if PLAIN_LINE.match(line) and "M" not in line else 0
        if run > best[1] - best[0]:
            best = (k + 1 - run, k + 1)
    if best[1] - best[0] < 2 or "LBL 77" in text:
        return None
    return lines[: best[0]], lines[best[0] : best[1]], lines[best[1] :]


def repeat_klartext(text: str) -> tuple[str, str] | None:
    """Drive a run of blocks three times: written three times, and by a repeat of its label."""
    found = find_klartext_run(text)
    if found is None:
        return None
    before, run, after = found
    loop = ["LBL 77", *run, "CALL LBL 77 REP 2"]
    return _number([*before, *run, *run, *run, *after]), _number([*before, *loop, *after])


def call_klartext(text: str) -> tuple[str, str] | None:
    """Put a run of blocks into a subprogram behind the end of the main program."""
    found = find_klartext_run(text)
    if found is None or not any(re.search(r"\bM0?(2|30)\b", line) for line in found[2]):
        return None
    before, run, after = found
    tail = after[-1:] if after[-1].startswith("END PGM") else []
    main = after[: len(after) - len(tail)]
    called = [*before, "CALL LBL 77", *main, "LBL 77", *run, "LBL 0", *tail]
    return _number([*before, *run, *after]), _number(called)


def scale_klartext(text: str) -> str | None:
    """Write a Heidenhain program of millimetres in inches; programs with parameters or cycles are left alone."""
    if " MM" not in text or re.search(r"Q\d|CYCL|FN |TOOL DEF|FUNCTION|PLANE", text):
        return None

    def scaled(match: re.Match[str]) -> str:
        return match[0] if match[0] == "R0" else f"{match[1]}{float(match[2]) / 25.4:+.13f}"

    lines = []
    for line in text.splitlines():
        if " BEGIN PGM" in line or " END PGM" in line:
            line = line.replace(" MM", " INCH")
        elif "TOOL CALL" not in line and "BLK" not in line and re.match(r"\d+ +(L|C|CC|CR|LP|CP|RND|CHF) ", line):
            line = re.sub(r"(\bI?[XYZR]|\bPR|\bIPR)([-+]?[\d.]+)(?=\s|$)", scaled, line)
            line = re.sub(r"(\bF)(\d[\d.]*)", lambda m: f"F{float(m[2]) / 2.54:.13f}", line)
        elif "TOOL CALL" in line:
            line = re.sub(r"(\bF)(\d[\d.]*)", lambda m: f"F{float(m[2]) / 2.54:.13f}", line)
        lines.append(line)
    return "\n".join(lines) + "\n"


def _number(lines: list[str]) -> str:
    return "".join(f"{k} {line}\n" for k, line in enumerate(lines))


def add_sinumerik_comments(text: str) -> str:
    """Number the blocks of a Sinumerik program anew and put remarks behind them."""
    lines = []
    for k, line in enumerate(text.splitlines()):
        code = line.split(";")[0].strip()
        if not code or code.startswith("%") or re.match(r"[A-Z_]+\d*:|PROC|EXTERN|DEF", code) or "GOTO" in text:
            lines.append(line)
            continue
        lines.append(f"N{5 * k + 5} " + re.sub(r"^N\d+ *", "", code) + " ; a remark, X99")
        lines.append("; G0 X99 Y99")
    return "\n".join(lines) + "\n"


def shuffle_sinumerik(text: str) -> str | None:
    """Write the words of plain Sinumerik blocks in another order."""
    rng, lines, count = random.Random(3), [], 0
    for line in text.splitlines():
        code, _, comment = line.partition(";")
        words = code.split()
        head = words[:1] if words and re.match(r"N\d+$", words[0]) else []
        body = words[len(head) :]
        if len(body) > 1 and all(SINUMERIK_WORD.match(word) for word in body):
            mixed = body[:]
            for _ in range(20):
                rng.shuffle(mixed)
                if mixed != body:
                    count += 1
                    break
            body = mixed
            lines.append(" ".join([*head, *body]) + (f" ;{comment}" if comment else ""))
        else:
            lines.append(line)
    return "\n".join(lines) + "\n" if count else None


def repeat_sinumerik(text: str) -> tuple[str, str] | None:
    """Drive a run of straight blocks three times: written three times, and in a FOR loop."""
    lines = [re.sub(r"^N\d+ *", "", line) for line in text.splitlines()]
    if re.search(r"GOTO|LABEL|MCALL|R[1-9]\d*\s*=|FOR|WHILE|REPEAT", text):
        return None
    best, run = (0, 0), 0
    for k, line in enumerate(lines):
        run = run + 1 if re.match(r"(G0?[01] )?[XYZ][-\d.]+( [XYZ][-\d.]+)*( F\d+)?$", line) else 0
        if run > best[1] - best[0]:
            best = (k + 1 - run, k + 1)
    if best[1] - best[0] < 2:
        return None
    before, body, after = lines[: best[0]], lines[best[0] : best[1]], lines[best[1] :]
    loop = ["FOR R50=1 TO 3", *body, "ENDFOR"]
    return "\n".join([*before, *body, *body, *body, *after]) + "\n", "\n".join([*before, *loop, *after]) + "\n"


def shift_sinumerik(text: str) -> str | None:
    """Shift the frame by ATRANS, write a run of straight blocks less that shift, and shift back."""
    if re.search(r"MCALL|TRANS|ROT|SCALE|MIRROR|G91|IC\(|G700?\b|AC\(", text):
        return None
    lines = [re.sub(r"^N\d+ *", "", line) for line in text.splitlines()]
    best, run = (0, 0), 0
    for k, line in enumerate(lines):
        run = run + 1 if re.match(r"(G0?[01] )?[XYZ][-\d.]+( [XYZ][-\d.]+)*( F\d+)?$", line) else 0
        if run > best[1] - best[0]:
            best = (k + 1 - run, k + 1)
    if best[1] - best[0] < 2:
        return None
    shift = {"X": 5.0, "Y": -3.0, "Z": 2.0}
    body = [re.sub(r"([XYZ])([-\d.]+)", lambda m: f"{m[1]}{float(m[2]) - shift[m[1]]:.6f}", line)
            for line in lines[best[0] : best[1]]]  # fmt: skip
    parts = [*lines[: best[0]], "TRANS X5 Y-3 Z2", *body, "TRANS", *lines[best[1] :]]
    return "\n".join(parts) + "\n"


def add_apt_comments(text: str) -> str:
    """Put remarks between the statements of an APT program, not where one goes on in the next line."""
    lines, goes_on = [], False
    for line in text.splitlines():
        lines.append(line)
        goes_on = line.rstrip().endswith(("$", ","))
        if not goes_on:
            lines.append("$$ GOTO/99,99,99")
    return "\n".join(lines) + "\n"


def add_blank_lines(text: str) -> str:
    """Put an empty line and blanks at the ends of lines."""
    return "".join(f"{line}  \n" for line in text.splitlines())
