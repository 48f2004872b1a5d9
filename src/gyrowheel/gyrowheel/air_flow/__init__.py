"""Computed and published torques of the air: verbs `air` and `cfd`."""
