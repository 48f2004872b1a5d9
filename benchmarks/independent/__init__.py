"""The finder on recordings that this project's simulation did not make: ``python -m benchmarks.independent``.

A finder that is only ever tried on the simulation that it was written with may have learned the simulation. Here the
mechanism is MuJoCo's, integrated in its joints and not in the case; the controller has other filters, gains and
references; parameters are read from the bench file as plain numbers; every effect is written down again from its
formula. `machine`, `controller`, `instruments`, `sequence` and `loop` import nothing of the project. What they share
with it is the format of a recording, which `cases` writes, and the names of effects and coefficients.
"""
