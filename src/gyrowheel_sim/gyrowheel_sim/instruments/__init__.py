"""The instruments of the bench: what they read, with which noise and drift; one sample of all of them is a row.

`readings` names the readings, `kernel` computes them from the true state as part of the compiled plant.
"""
