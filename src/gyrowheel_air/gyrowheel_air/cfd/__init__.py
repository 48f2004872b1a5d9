"""Computing the torque of the air with OpenFOAM: mesh, case, run, sweep."""
