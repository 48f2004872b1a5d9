"""The whole loop on a hidden effect: `gyrowheel demo`."""
