"""How fast and how exact the bench is, measured beside what else could be used: ``python -m benchmarks``.

Each module of `SUBJECTS` measures one subject: its ``measure(progress)`` returns reports, each with figures and the
sentences that say how they came about, and calls ``progress`` with the fraction done. A new subject is a new module and
a line in `SUBJECTS`.
"""

from __future__ import annotations

#: What can be measured: module, and what it is about.
SUBJECTS = {
    "simulation": "simulated seconds per second, beside SciPy and MuJoCo on the same mechanism",
    "integrator": "false torque that the integrator makes",
    "start_up": "time from the command to the first step",
    "diagnosis": "time and memory of a diagnosis, minutes and an hour of samples, stage by stage",
    "mutations": "damaged recordings and YAML files: refused, or read exactly",
}
