"""Transform G-code in plain text so that the path stays the same: words, modes, units, arcs, loops, subprograms.

The transformers know blocks and words only. A block that they do not understand is left as it is, and every position
that it may change counts as unknown from there on. `None` is returned where a program offers nothing to transform.
"""

from __future__ import annotations

import math
import random
import re
from dataclasses import dataclass

COMMENT = re.compile(r"\([^)]*\)?|;.*")
WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)
AXES = "XYZ"
#: Letters of lengths; F is a length a minute.
LENGTHS = "XYZIJKRUVWF"
PLANES = {"G17": "XY", "G18": "ZX", "G19": "YZ"}
CENTRES = {"X": "I", "Y": "J", "Z": "K"}
#: Preparatory words after which axis words are not plain coordinates of the part frame.
MACHINE = {"G28", "G30", "G53", "G10", "G92", "G52", "G4", "G31", "G68", "G50", "G51", "G65", "G66"}
#: Words that move the part frame: positions are unknown after them.
FRAMES = {*(f"G{k}" for k in range(54, 60)), "G43", "G49", "G92.1", "G69", "G52", "G92", "G10", "G154", "G54.1"}
CYCLES = {f"G{k}" for k in range(81, 90)} | {"G73", "G74", "G76"}
#: Words that change what coordinates mean: programs with them are left alone by all that computes positions.
STRANGE = {"G16", "G15", "G68", "G69", "G93", "G51", "G50", "G70.1", "G7", "G12", "G13", "G91.1", "G90.1", "G112"}


@dataclass
class Block:
    """A line: words in their order, comment, and whether all of it was understood."""

    words: list[tuple[str, str]]
    comment: str
    plain: bool
    text: str

    @property
    def codes(self) -> set[str]:
        """Preparatory words without leading zeros, such as G1 and G91.1."""
        return {f"G{float(v):g}" for letter, v in self.words if letter == "G"}

    def has(self, letters: str) -> bool:
        """Whether a word of one of these letters is there."""
        return any(letter in letters for letter, _ in self.words)

    def value(self, letter: str) -> float | None:
        """Number of the last word of a letter."""
        return next((float(v) for key, v in reversed(self.words) if key == letter), None)

    def write(self) -> str:
        """The line."""
        return " ".join([*(f"{letter}{v}" for letter, v in self.words), *([self.comment] if self.comment else [])])


def split(text: str) -> list[Block]:
    """Read blocks."""
    blocks = []
    for line in text.splitlines():
        code = COMMENT.sub("", line)
        words = [(letter.upper(), v) for letter, v in WORD.findall(code)]
        plain = not WORD.sub("", code).strip() and code.strip() != ""
        blocks.append(Block(words, " ".join(COMMENT.findall(line)), plain, line))
    return blocks


def number(value: float) -> str:
    """Write a number with all digits that matter."""
    return f"{value:.13f}"


def is_motion(block: Block) -> bool:
    """Whether a block is plain straight or circular motion in the part frame."""
    codes = block.codes
    return (block.plain and block.has(AXES + "IJK") and not codes & (MACHINE | FRAMES | CYCLES | STRANGE)
            and not block.has("TMHDPLQOUVWABCE"))  # fmt: skip


def understood(blocks: list[Block]) -> bool:
    """Whether positions can be followed through a program by simple means."""
    return not any(block.codes & STRANGE for block in blocks) and not any(
        re.search(r"[#\[\]=]|M98|M97|G65", COMMENT.sub("", block.text)) for block in blocks
    )


def follow(blocks: list[Block]):
    """Yield block, absolute mode, modal motion (G0 .. G3 or a cycle), plane, positions before it (None: unknown)."""
    place: dict[str, float | None] = dict.fromkeys(AXES)
    absolute, motion, plane = True, "", "G17"
    for block in blocks:
        codes = block.codes
        absolute = "G90" in codes or (absolute and "G91" not in codes)
        plane = next((g for g in PLANES if g in codes), plane)
        motion = next((g for g in codes if g in {"G0", "G1", "G2", "G3", "G80"} | CYCLES), motion)
        if codes & FRAMES or not block.plain:
            moved = bool(block.words) or not block.plain
            if moved and COMMENT.sub("", block.text).strip() not in ("", "%"):
                place = dict.fromkeys(AXES)
        yield block, absolute, motion, plane, dict(place)
        if not block.has(AXES) or any(letter == "M" and float(v) >= 100 for letter, v in block.words):
            continue  # settings of printers, such as M205 X9
        if codes & (MACHINE | STRANGE) or not block.plain:
            place = dict.fromkeys(AXES)
            continue
        for axis in AXES:
            value, before = block.value(axis), place[axis]
            if value is not None:
                place[axis] = value if absolute else None if before is None else before + value
        if motion in CYCLES:
            place["Z"] = None


def swap_distance_mode(text: str) -> str | None:
    """Write absolute blocks as incremental ones and the other way round."""
    blocks, lines, mode, count = split(text), [], True, 0
    if not understood(blocks):
        return None
    for block, absolute, motion, _, before in follow(blocks):
        swap = is_motion(block) and motion in {"G0", "G1", "G2", "G3"} and all(
            before[a] is not None for a in AXES if block.value(a) is not None
        )  # fmt: skip
        if not block.words or not block.plain:
            lines.append(block.text)
            continue
        wanted = absolute != swap
        words = [(k, v) for k, v in block.words if not (k == "G" and float(v) in (90.0, 91.0))]
        if swap:
            count += 1
            words = [
                (k, number(float(v) + (-1.0 if absolute else 1.0) * (before[k] or 0.0)) if k in AXES else v)
                for k, v in words
            ]
        if wanted != mode or (words != block.words and not swap):
            at = 1 if words and words[0][0] in "NO" else 0
            words.insert(at, ("G", "90" if wanted else "91"))
        mode = wanted
        lines.append(Block(words, block.comment, True, "").write())
    return "\n".join(lines) + "\n" if count else None


def swap_unit(text: str) -> str | None:
    """Write a program in millimetres in inches and the other way round; it has to state its unit."""
    blocks = split(text)
    stated = {g for block in blocks for g in block.codes} & {"G20", "G21"}
    # a peck of a rounded depth may leave a rest of it, which is another peck
    if len(stated) != 1 or any(block.codes & (STRANGE | {"G70", "G71", "G10", "G73", "G83"}) for block in blocks):
        return None
    if any(re.search(r"[#\[\]=]", COMMENT.sub("", block.text)) for block in blocks):
        return None
    inch = "G20" in stated
    scale = 25.4 if inch else 1.0 / 25.4
    lines, seen = [], False
    for block in blocks:
        codes = block.codes
        if not block.plain:
            lines.append(block.text)
            continue
        words = []
        for letter, value in block.words:
            new = value
            if letter == "G" and f"G{float(value):g}" in stated:
                new, seen = "21" if inch else "20", True
            elif "G4" not in codes and letter in LENGTHS:
                if not seen:
                    return None
                new = number(float(value) * scale)
            words.append((letter, new))
        lines.append(Block(words, block.comment, True, "").write())
    return "\n".join(lines) + "\n"


def swap_arc_form(text: str) -> str | None:
    """Write arcs with a radius with their centre, and arcs with a centre with their radius."""
    blocks, lines, count = split(text), [], 0
    if not understood(blocks):
        return None
    for block, absolute, motion, plane, before in follow(blocks):
        words = None
        if is_motion(block) and motion in {"G2", "G3"} and block.has(AXES):
            words = _other_arc(block, absolute, motion == "G2", PLANES[plane], before)
        if words is None:
            lines.append(block.text)
        else:
            count += 1
            lines.append(Block(words, block.comment, True, "").write())
    return "\n".join(lines) + "\n" if count else None


def _other_arc(block: Block, absolute: bool, clockwise: bool, plane: str, before: dict) -> list | None:
    start = [before[axis] for axis in plane]
    if None in start:
        return None
    given = [block.value(axis) for axis in plane]
    if absolute:
        end = [s if g is None else g for s, g in zip(start, given, strict=True)]
    else:
        end = [s + (g or 0.0) for s, g in zip(start, given, strict=True)]
    dx, dy = end[0] - start[0], end[1] - start[1]
    chord = math.hypot(dx, dy)
    if chord < 1e-3:
        return None  # a full circle has no radius form
    sense = -1.0 if clockwise else 1.0
    radius = block.value("R")
    kept = [(k, v) for k, v in block.words if k not in "IJKR"]
    if radius is not None:
        rise = math.sqrt(max(radius**2 - 0.25 * chord**2, 0.0)) * (1.0 if radius > 0 else -1.0) * sense
        centre = (0.5 * dx - rise * dy / chord, 0.5 * dy + rise * dx / chord)
        letters = [CENTRES[axis] for axis in plane]
        return [*kept, *((k, number(v)) for k, v in zip(letters, centre, strict=True))]
    centre = tuple(block.value(CENTRES[axis]) or 0.0 for axis in plane)
    if block.has("IJK") is False:
        return None
    first, last = math.hypot(*centre), math.hypot(dx - centre[0], dy - centre[1])
    if abs(first - last) > 1e-7:
        return None  # the centre is rounded: its radius form is another arc
    sweep = math.atan2(dy - centre[1], dx - centre[0]) - math.atan2(-centre[1], -centre[0])
    sweep = (sense * sweep) % (2.0 * math.pi)
    if abs(sweep - math.pi) < 0.02 or sweep < 0.02 or sweep > 2.0 * math.pi - 0.02:
        return None  # a radius tells its centre badly there
    return [*kept, ("R", number(first if sweep < math.pi else -first))]


def shuffle_words(text: str) -> str | None:
    """Write the words of each block in another order; block number and program number stay in front."""
    if re.search(r"(?m)^M10[49]\b", text):
        return None  # firmware of printers takes the first word of a line for its command
    rng, lines, count = random.Random(7), [], 0
    for block in split(text):
        movable = [w for w in block.words if w[0] not in "NO"]
        codes = [w for w in movable if w[0] in "GMT"]
        if not block.plain or len(movable) < 2 or len(codes) == len(movable) == 1 or "G10" in block.codes:
            lines.append(block.text)
            continue
        mixed = movable[:]
        while mixed == movable:
            rng.shuffle(mixed)
        count += 1
        head = [w for w in block.words if w[0] in "NO"]
        lines.append(Block([*head, *mixed], block.comment, True, "").write())
    return "\n".join(lines) + "\n" if count else None


def add_numbers_and_comments(text: str) -> str | None:
    """Number every block anew and put remarks before and behind blocks."""
    if "GOTO" in text:
        return None  # it jumps to block numbers
    brackets = "(" in text or ";" not in text
    remark = "(a remark, X99 Y99)" if brackets else "; a remark, X99 Y99"
    lines = []
    for k, block in enumerate(split(text)):
        code = COMMENT.sub("", block.text).strip()
        if not code or code == "%" or not block.plain or block.has("O") or block.text.startswith("/"):
            lines.append(block.text)
            continue
        words = [w for w in block.words if w[0] != "N"]
        lines.append(" ".join([f"N{10 + k}", *(f"{letter}{v}" for letter, v in words), block.comment or remark]))
        if k % 3 == 0:
            lines.append(remark)
    return "\n".join(lines) + "\n"


def find_body(text: str) -> tuple[list[str], list[str], list[str]] | None:
    """Find a run of plain cutting blocks in absolute mode between which nothing else stands: before, run, after."""
    blocks = split(text)
    if not understood(blocks):
        return None
    best, run = (0, 0), 0
    for k, (block, absolute, motion, _, _) in enumerate(follow(blocks)):
        good = is_motion(block) and absolute and motion in {"G0", "G1", "G2", "G3"} and "G91" not in block.codes
        run = run + 1 if good else 0
        if run > best[1] - best[0]:
            best = (k + 1 - run, k + 1)
    first, last = best[0] + 1, min(best[1], best[0] + 13)  # its first block stays: it says mode and place
    if last - first < 2:
        return None
    lines = [Block([w for w in b.words if w[0] != "N"], b.comment, True, "").write() if b.plain else b.text
             for b in blocks]  # fmt: skip
    return lines[:first], lines[first:last], lines[last:]


def call_subprogram(text: str) -> str | None:
    """Put a run of blocks into a subprogram that is called where the run stood."""
    found = find_body(text)
    if found is None or not re.search(r"\bM0?(2|30)\b", text):
        return None
    before, run, after = found
    tail = [line for line in after if line.strip() != "%"]
    return "\n".join([*before, "M98 P9107", *tail, "O9107", *run, "M99", "%"]) + "\n"


def repeat_run(text: str) -> tuple[str, str] | None:
    """Cut a run of blocks three times: written three times, and in a loop."""
    found = find_body(text)
    if found is None:
        return None
    before, run, after = found
    rows = list(follow(split(text)))
    _, _, _, _, start = rows[len(before)]
    earlier = rows[len(before) - 1][2]
    if None in start.values():
        return None
    back = "G1 " + " ".join(f"{axis}{number(value)}" for axis, value in start.items())
    run = [back, *([earlier] if not re.search(r"G0?[0-3]\b", run[0]) and earlier != "G1" else []), *run]
    loop = ["#101=0", "WHILE [#101 LT 3] DO1", *run, "#101=#101+1", "END1"]
    return "\n".join([*before, *run, *run, *run, *after]) + "\n", "\n".join([*before, *loop, *after]) + "\n"


def shift_and_back(text: str) -> str | None:
    """Shift the frame by G52, write a run of blocks less that shift, and shift back."""
    found = find_body(text)
    if found is None or "G52" in text or not re.search(r"G5[4-9]\b", text):
        return None
    before, run, after = found
    shift = {"X": 5.0, "Y": -3.0, "Z": 2.0}
    moved = []
    for block in split("\n".join(run)):
        words = [(k, number(float(v) - shift[k]) if k in shift else v) for k, v in block.words]
        moved.append(Block(words, block.comment, True, "").write())
    return "\n".join([*before, "G52 X5. Y-3. Z2.", *moved, "G52 X0. Y0. Z0.", *after]) + "\n"
