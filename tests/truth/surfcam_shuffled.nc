%
o0015
n5 g90g21 g17
n7 f600 s5000 x1. g0 z5. m3 y2.
n11 z-1. f200 g1
n12 f 600 y 22. x 1.
n90 j 0. i 5. y 27. x 6. g2
n91 g0 z 5.
m30
%
