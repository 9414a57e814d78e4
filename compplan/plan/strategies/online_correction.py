"""The loops of online elastic correction with force feedback, a control loop at 100 Hz [Johra2022].

As `force_sensor_full`, but the correction reaches the tool through a PI or PID law and a robot with lag and delay. The
law of the paper taken literally (PID, error from the correction sent one period before) has a pole of 2.29 and runs
away; `LITERAL` keeps it for showing. Without its derivative part it is stable (0.91); the PID is stable where its error
comes from where the robot stands, on the plant that its gains fit.
"""

from __future__ import annotations

from compplan.plan.correction_loop import Loop, Plant

#: The law as printed, on a robot that follows at once: unstable.
LITERAL = Loop(plant=Plant(0.0, 0.0), error="sent")
#: The same without its derivative part; the robot follows with lag and delay outside the loop.
PI = Loop(derivative=0.0, error="sent")
#: The PID with the error from where the robot stands.
PID = Loop(error="attained")
#: The three by name, for comparisons.
LOOPS = {"as printed": LITERAL, "PI": PI, "PID": PID}
