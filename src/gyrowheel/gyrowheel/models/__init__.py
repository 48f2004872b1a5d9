"""Model files: bench, effects and history."""
