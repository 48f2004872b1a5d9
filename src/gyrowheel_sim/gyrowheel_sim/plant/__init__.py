"""The simulated machine: compiled kernel, scenario, guard, pacing, and its node."""
