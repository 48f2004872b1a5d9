"""Speed and accuracy of the bench, compared with alternatives: ``python -m benchmarks``.

Each module of `SUBJECTS` measures one subject: its ``measure(progress)`` returns reports, each with figures and notes
on the method, and calls ``progress`` with the fraction done. A new subject is a new module and a line in `SUBJECTS`.
"""

from __future__ import annotations

#: Subjects: module and description.
SUBJECTS = {
    "simulation": "simulated seconds per second, compared with SciPy and MuJoCo on the same mechanism",
    "integrator": "false torque of the integrator",
    "start_up": "time from the command to the first step",
    "graph": "the nodes in lock-step, compared with a minimal ping-pong",
    "realtime": "ten recorded minutes in real time: lost samples, late commands and their causes, memory of the nodes",
    "hour": "an hour of the same, then diagnosed",
    "stalls": "the plant stopped twenty times in a real-time run: accuracy of the reported stalls",
    "diagnosis": "time and memory of a diagnosis, for minutes and for an hour of samples, stage by stage",
    "workbench": "an hour in the browser: opening, zoom, memory, compared with plotly-resampler; delay of a diagnosis",
    "load": "200 jobs, 20 saves and 300 connections of the workbench: time of its answers, memory",
    "live": "the live pane next to a bench in real time: frames, memory of the browser, pace of the graph",
    "recording": "columns read per second, rosbags and mcap_ros2 as peers; the recorder at 10 000 messages/s, killed",
    "solver": "one fit of a recording, our Gauss-Newton compared with SciPy's least_squares: time, same minimum",
    "killed": "kill -9 at random instants of verbs that write, and fifty concurrent writers of one model",
    "readers": "our MCAP reader and writer compared with rosbags' raw bytes: time, detected damage, loss by a kill",
}

#: Subjects that are measured only if they are named, because they take long.
LONG = {"hour"}
