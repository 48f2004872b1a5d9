"""The diagnosis on recordings of an independent simulation: ``python -m benchmarks.independent``.

A diagnosis that is tested only on the simulation with which it was developed may be fitted to that simulation. Here
the mechanism is MuJoCo's, integrated in joint angles and not in the case frame; the controller has other filters, gains
and references; parameters are read from the bench file as plain numbers; every effect is implemented again from its
formula. `machine`, `controller`, `instruments`, `sequence` and `loop` import nothing of the project. They share only
the format of a recording, which `cases` writes, and the names of effects and coefficients.
"""
