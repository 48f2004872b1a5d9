"""Campaigns of blind cases: hidden machines are recorded and diagnosed, and a judge compares verdict and truth.

The parts share only the physics: `hidden` draws a machine and records it; `finder` gets the recordings and the model
of the bench; `judge` alone sees answer and secret. `case` is one case from beginning to end, `summary` counts; the
module `gyrowheel.batches.workers` runs the cases on the cores of this machine or on a Dask cluster.
"""
