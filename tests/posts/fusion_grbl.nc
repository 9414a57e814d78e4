(pocket)
(T1  D=3.175 CR=0 - ZMIN=-2 - flat end mill)
G90 G94
G17
G21
(When using Fusion 360 for Personal Use, the feedrate of)
(rapid moves is reduced to match the feedrate of cutting)
G28 G91 Z0
G90
(2D Pocket1)
S10000 M3
G54
G0 X12.113 Y7.5
Z15
Z5
G1 Z1 F333.3
X12.107 Z0.82
X12.09 Z0.643 F1000
G3 X11.613 Y8 Z0.2 I-0.5 J0
X11.113 Y7.5 Z-0.2 R0.5
X12.113 Y7.5 Z-1 I0.5
G1 Y9.25
G2 X13.113 Y10.25 I1 J0
G1 X20
G1 X12.1 Y7.4 Z-2
G0 Z15
M5
G28 G91 Z0
G90
G28 G91 X0 Y0
G90
M30
