"""A second, plain reading of what goes in and of what comes out: CAM files, robot programs, controller tables.

It is written from the standards and manuals and shares nothing with the readers and writers that it checks. What it
does not know it says it cannot tell (`CannotTellError`); nothing is guessed.
"""
