"""Mutants of CAM files: whatever is in a file, it is read or refused in one line, in bounded time and memory.

    python -m benchmarks bad_inputs.cam_mutants FORMAT --count 10000 --seed 1 [--from FOLDER]

FORMAT is the name of a reader. Mutants are drawn by the seed from the small program of that language in `cam/`, and
from the files of a folder where one is named. It prints how many were read, refused and failed, the slowest one and
the memory of the whole run; exit status 1 if any failed, took longer than 5 s, or the run took more than 1 GB.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers import READERS, CamTable, read_cam, refuse_idle
from compplan.toolpath.toolpath import check_toolpath

SLOWEST = 5.0
MOST_MEMORY = 2**30
PROGRAMS = {file.stem: file.read_text(encoding="utf-8") for file in sorted(Path(__file__).parent.glob("cam/*.*"))}
ODD = [
    "1e999",
    "nan",
    "-inf",
    "1000000000000",
    "1E-300",
    "0",
    "-0",
    "1O",
    "1.2.3",
    "",
    "99999999",
    "0.0000001",
    "1,5",
    "--1",
]
SIGNS = list("()[]{}\"';,$%!#&=/\\*:+-. \t\r\n\x85\x0c\x00\u2028\u2029\ufeff\xe4")
SIGNS += ["$\n", "\n%\n", "(((", ")))", "$$"]


@dataclass
class Tally:
    """Count what became of the mutants."""

    read: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    slowest: float = 0.0
    slowest_number: int = -1

    @property
    def memory(self) -> int:
        """Greatest memory of the process so far [bytes]."""
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def mutate(text: str, draw: random.Random) -> str:
    """Return a text with one to three faults."""
    for _ in range(draw.randint(1, 3)):
        place = draw.randrange(len(text) + 1)
        kind = draw.randrange(9)
        lines = text.split("\n")
        if kind == 0:
            text = text[:place] + text[place + draw.randint(1, 3) :]
        elif kind == 1:
            text = text[:place] + draw.choice(SIGNS) + text[place:]
        elif kind == 2:
            text = text[:place] + chr(draw.randrange(32, 127)) + text[place + 1 :]
        elif kind == 3:
            text = _odd_number(text, place, draw)
        elif kind == 4:
            lines.insert(draw.randrange(len(lines)), draw.choice(lines))
            text = "\n".join(lines)
        elif kind == 5:
            del lines[draw.randrange(len(lines))]
            text = "\n".join(lines)
        elif kind == 6:
            text = text[:place] if draw.random() < 0.2 else text
        elif kind == 7:
            end = min(len(text), place + draw.randint(1, 30))
            text = text[:end] + text[place:end] * draw.choice([1, 2, 400]) + text[end:]
        else:
            text = text[:place] + draw.choice("GXYZIJKRPLFABCE") + draw.choice(ODD) + text[place:]
    return text


def _odd_number(text: str, place: int, draw: random.Random) -> str:
    """Put an odd number in place of the first one after a place."""
    digits = "0123456789."
    first = next((k for k in range(place, len(text)) if text[k] in digits), None)
    if first is None:
        return text
    last = next((k for k in range(first, len(text)) if text[k] not in digits), len(text))
    return text[:first] + draw.choice(ODD) + text[last:]


def run_mutants(language: str, count: int, seed: int, folder: Path | None = None) -> Tally:
    """Read mutants of programs of one language.

    Args:
        language: Name of the reader.
        count: How many.
        seed: What they are drawn by; the same seed draws the same ones.
        folder: Folder with more programs to draw from, or None.

    """
    draw, tally = random.Random(f"{language} {seed}"), Tally()
    suffix = READERS[language].suffixes[0]
    programs = [PROGRAMS[language]] if language in PROGRAMS else []
    for path in sorted(folder.rglob("*")) if folder else []:
        if path.suffix.lower() in READERS[language].suffixes:
            programs.append(path.read_text(encoding="latin-1"))
    if not programs:
        raise LookupError(f"no program of {language} to mutate, expected benchmarks/bad_inputs/cam/{language}.*")
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / f"part{suffix}"
        for number in range(count):
            file.write_bytes(mutate(draw.choice(programs), draw).encode(draw.choice(["utf-8", "latin-1"]), "replace"))
            compensation = draw.choice([None, "centre_line"])
            options = CamTable(cycles=draw.choice(["skip", "expand"]), rotary="head", compensation=compensation)
            _read_one(file, options, number, tally)
    return tally


def _read_one(file: Path, options: CamTable, number: int, tally: Tally) -> None:
    began = time.process_time()
    try:
        check_toolpath(refuse_idle(read_cam(file, options)), need_feed=False)
        tally.read += 1
    except InputError as error:
        tally.refused += 1
        if "\n" in str(error) or str(file) not in str(error):
            tally.failures.append(f"mutant {number}: refused in more than a line, or without the file: {error!s:.200}")
    except Exception as error:
        tally.failures.append(f"mutant {number}: {type(error).__name__}: {error!s:.200}")
    took = time.process_time() - began
    if took > tally.slowest:
        tally.slowest, tally.slowest_number = took, number


def main() -> int:
    """Run the command; return the exit status."""
    parser = argparse.ArgumentParser(description="Read mutants of CAM files.")
    parser.add_argument("language", metavar="FORMAT", choices=[*READERS])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--from", dest="folder", type=Path)
    given = parser.parse_args()
    tally = run_mutants(given.language, given.count, given.seed, given.folder)
    for failure in tally.failures[:20]:
        print(failure)
    told = f"{tally.read} read, {tally.refused} refused, {len(tally.failures)} failed"
    print(f"{given.language}: {given.count} mutants, {told}")
    print(f"slowest {tally.slowest:.2f} s (mutant {tally.slowest_number}), memory {tally.memory / 2**20:.0f} MB")
    return int(bool(tally.failures) or tally.slowest > SLOWEST or tally.memory > MOST_MEMORY)


if __name__ == "__main__":
    sys.exit(main())
