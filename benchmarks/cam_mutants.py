"""Mutants of CAM files: whatever is in a file, it is read or refused in one line, in bounded time and memory.

    python -m benchmarks.cam_mutants FORMAT --count 10000 --seed 1 [--from FOLDER]

FORMAT is the name of a reader. Mutants are drawn by the seed from a small program of each language that stands here,
and from the files of a folder where one is named. It prints how many were read, refused and failed, the slowest one and
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
from compplan.path.cam import READERS, CamTable, read_cam, refuse_idle
from compplan.path.toolpath import check_toolpath

SLOWEST = 5.0
MOST_MEMORY = 2**30
PROGRAMS = {
    "gcode": """%
O1000 (PART)
G21 G17 G90 G94
G10 L2 P1 X0 Y0 Z0
G54 G0 X0 Y0 Z5
T="MILL" M6
S6000 M3 M8 (start)
G4 P1500
G1 Z-1 F300
X10 ,R1
Y10 ,C2
X20
G2 X30 Y20 I0 J10 F200
G3 X20 Y20 R5
G18 G2 X30 I5 K0
G17 G91 G1 X1 Y1
G90 G2 I5 Z-8 P3
G81 X5 Y5 Z-3 R2 F60
G91 X5 L3
G80 G90
#1 = 2
WHILE [#1 GT 0] DO 1
G1 X[20 + #1 * 2] Y#1
#1 = #1 - 1
END 1
IF [#1 EQ 0] GOTO 90
G1 X99
N90 G68 X0 Y0 R30
G1 X10 Y0
G69
G51 X0 Y0 Z0 P2.
G1 X5
G50
G28 G91 Z0
G90 G0 X0 Y0
Z5
MSG("done; here")
TRAORI
G1 X1 A10 C20
G1 X2 A3=0.1 B3=0 C3=1
M1
TRANS X5
G53 G0 Z0
G1 X2
L100 P2
M30
%_N_L100_SPF
G1 X3
M17
""",
    "apt": """PARTNO/PART
UNITS/MM
MULTAX/ON
CUTTER/10
FROM/0,0,50
SPINDL/3000,CLW
COOLNT/FLOOD
LOADTL/2
DELAY/1.5
PPRINT/ROUGH
AUXFUN/9
FEDRAT/300,MMPM
RAPID
GOTO/20,0,5,0,0,1
GOTO/20,0,0
CIRCLE/10,0,0,0,0,1,10
GOTO/10,10,0
GODLTA/1,2,3
GOTO/ 20.0, $
 10.0, 0.0, 0.0, 0.6, 0.8
GOTO/20,0,0,0,0,1
INDIRV/0,1,0
TLON,GOFWD/(CIRCLE/10,0,0,10),ON,(LINE/10,0,0,10,10,0)
CYCLE/DRILL,DEPTH,5,CLEAR,2
GOTO/1,1,0
CYCLE/OFF
GOTO/5,0,0
MOVARC/0,0,0,0,0,1,5,ANGLE,90
GOTO/3,4,0
TRANS/0,0,0
FINI
""",
    "krl": """&ACCESS RVP
DEF part()
;FOLD INI
BAS(#INITMOV,0)
;ENDFOLD
BASE_DATA[1]={X 100,Y 0,Z 0,A 0,B 0,C 0}
BAS(#BASE,1)
DECL E6POS P1={X 0,Y 0,Z 50,A 0,B 180,C 0,S 2,T 3}
$VEL.CP=0.05
PTP {A1 0,A2 -90,A3 90}
PTP P1
LIN {E6POS: X 0,Y 0,Z 0,A 0,B 180,C 0} C_DIS
CIRC {X 5,Y 5},{X 10,Y 0,B 170} C_DIS
CIRC {X 5,Y 5},{X 0,Y 0},CA 720
SPLINE
SPL {X 20}
SPL {X 30,Y 10}
ENDSPLINE
IF $IN[1] THEN
HALT
ENDIF
$OUT[3]=TRUE
WAIT SEC 2.5 ; up to speed
P1.X=3
SLIN P1 WITH $VEL.CP=0.1
SPINDLE(3000)
cut()
END
DEF cut()
LIN {X 5}
END
""",
    "rapid": """%%%
VERSION:1
LANGUAGE:ENGLISH
%%%
MODULE part
PERS wobjdata w:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
CONST robtarget p:=[[0,0,50],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget via:=[[15,5,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST speeddata v:=[25,500,5000,1000];
PROC main()
ConfL\\Off;
MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,t;
MoveJ p,v100,z10,t\\WObj:=w;
MoveL Offs(p,10,0,
-50),v,fine,t\\WObj:=w; ! in
MoveC via,[[20,0,0],[0,0.1,0.995,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v20,z1,t\\WObj:=w;
MoveL p,v50,z0,t\\WObj:=w;
TPWrite "done; !";
SetDO doMill,1;
WaitTime 2;
VelSet 50,1000;
MoveLDO RelTool(p,1,2,3),v50,z0,t\\WObj:=w,do1,1;
cut;
ENDPROC
PROC cut()
MoveL Offs(p,5,5,5),v50\\V:=10,z0,t\\WObj:=w;
ENDPROC
ENDMODULE
""",
    "sinumerik": """%_N_PART_MPF
;$PATH=/_N_WKS_DIR
N10 G17 G71 G90 G54
N20 DEF REAL DEEP=5, WAY
N30 T="MILL_10"
N40 M6
N50 S3000 D1 M3
N60 G0 X0 Y0
N70 Z10 M8
N80 R1=2 R2=R1*SIN(30)+SQRT(4)
N90 G1 Z=-R1 F300
N100 X=IC(10) RND=2
N110 Y20
N120 G3 X=AC(0) Y30 I=AC(0) J=AC(20)
N130 G2 X10 Y20 CR=-10
N140 CT X20 Y10
N150 CIP X30 Y0 I1=27 J1=7
N160 TRANS X5 Y1
N170 AROT RPL=30
N180 G1 X5 Y5
N190 ROT
N200 MCALL CYCLE81(20,0,2,-5)
N210 HOLES2(0,0,10,0,0,3)
N220 MCALL
N230 FOR WAY=1 TO 2
N240 G1 X=WAY*3 F200
N250 ENDFOR
N260 IF R1==2 GOTOF NEXT
N270 G0 X99
NEXT:
N280 G111 X0 Y0
N290 G1 AP=45 RP=10
N300 CYCLE800(1,"TC1",0,57,0,0,0,0,30,0,0,0,0,1)
N310 G0 X0 Y0 Z10
N320 G1 Z0 A3=0 B3=0 C3=1
N330 CYCLE800()
N340 G0 SUPA Z0
N350 L5 P2
N360 M30
%_N_L5_SPF
G4 F1
M17
""",
    "heidenhain": """0 BEGIN PGM PART MM
1 BLK FORM 0.1 Z X+0 Y+0 Z-20
2 BLK FORM 0.2 X+100 Y+100 Z+0
3 TOOL CALL 1 Z S3000 F500
4 L X+0 Y+0 Z+50 R0 FMAX M13
5 FN 0: Q1 = +5 ; depth
6 Q2 = Q1 * SIN 30 - ( 2 + SQRT 4 )
7 L Z-Q1 F300
8 APPR CT X+10 Y+10 CCA90 R+5 RL F400
9 L X+30
10 RND R2
11 CC X+30 Y+20
12 C X+40 Y+20 DR+
13 CR X+30 Y+30 R-10 DR+
14 CT X+20 Y+40
15 CP IPA+360 IZ-2 DR+
16 DEP LT LEN10 F800
17 LBL 1
18 L IX+2 IZ+1
19 CALL LBL 1 REP 2
20 CYCL DEF 7.0 DATUM SHIFT
21 CYCL DEF 7.1 X+10
22 CYCL DEF 10.0 ROTATION
23 CYCL DEF 10.1 ROT+30
24 CYCL DEF 200 DRILLING ~
  Q200=2 ;SET-UP ~
  Q201=-5 ~
  Q206=150 ~
  Q203=+0 ~
  Q204=20
25 L X+1 Y+1 R0 FMAX M99
26 CYCL DEF 10.1 ROT+0
27 PLANE SPATIAL SPA+0 SPB+30 SPC+0 STAY
28 L X+1 Y+1 Z+10 R0 FMAX
29 L Z+0 F100
30 PLANE RESET STAY
31 FN 9: IF +Q1 EQU +5 GOTO LBL 2
32 L X+99 FMAX
33 LBL 2
34 L Z+0 R0 FMAX M91
35 STOP M30
36 END PGM PART MM
""",
}
ODD = ["1e999", "nan", "-inf", "1000000000000", "1E-300", "0", "-0", "1O", "1.2.3", "", "99999999",
       "0.0000001", "1,5", "--1"]
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
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / f"part{suffix}"
        for number in range(count):
            file.write_bytes(mutate(draw.choice(programs), draw).encode(draw.choice(["utf-8", "latin-1"]), "replace"))
            compensation = draw.choice([None, "centre_line"])
            options = CamTable(cycles=draw.choice(["skip", "expand"]), rotary="head", compensation=compensation)
            _read_one(file, options, number, tally)
    return tally


def _read_one(file: Path, options: CamTable, number: int, tally: Tally) -> None:
    began = time.perf_counter()
    try:
        check_toolpath(refuse_idle(read_cam(file, options)), need_feed=False)
        tally.read += 1
    except InputError as error:
        tally.refused += 1
        if "\n" in str(error) or str(file) not in str(error):
            tally.failures.append(f"mutant {number}: refused in more than a line, or without the file: {error!s:.200}")
    except Exception as error:
        tally.failures.append(f"mutant {number}: {type(error).__name__}: {error!s:.200}")
    took = time.perf_counter() - began
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
