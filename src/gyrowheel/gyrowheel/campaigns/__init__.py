"""Many blind cases: hidden machines are recorded and diagnosed, and a judge compares verdict and truth.

Three parts that share nothing but the physics library and this order of events:

`hiding` draws a machine and records it; `finding` gets the recordings and the model of the bench, nothing else;
`judge` alone sees both the answer and the secret. `job.run_case` is one case from beginning to end, the function
that `workers` hands to the cores of this machine or to a Dask cluster; `summary` counts.
"""
