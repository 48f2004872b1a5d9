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
    "graph": "the nodes in lock-step beside a bare ping-pong",
    "realtime": "ten recorded minutes in real time: what is lost, what is late and why, memory of the nodes",
    "hour": "an hour of the same, then diagnosed",
    "stalls": "the plant stopped twenty times in a real-time run: what recording and diagnostics tell of it",
    "diagnosis": "time and memory of a diagnosis, minutes and an hour of samples, stage by stage",
    "workbench": "an hour in the browser: opening, zoom, memory, beside plotly-resampler; how soon a diagnosis shows",
    "recording": "columns read per second, beside rosbags and mcap_ros2; the recorder at 10 000 messages/s, killed",
    "studies": "every effect, instrument and verdict one by one: how many cases hold, of how many",
    "solver": "one fit of a recording, our Gauss-Newton beside SciPy's least_squares: time, same minimum",
    "killed": "kill -9 at random instants of verbs that write, and fifty writers of one model at once",
    "readers": "our MCAP reader and writer beside rosbags' raw bytes: time, damage that shows, what a kill loses",
}

#: What is measured only where it is asked for by name, because it takes so long.
LONG = {"hour"}
