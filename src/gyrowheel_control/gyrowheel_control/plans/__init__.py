"""Test plans: their format, their variations, and those that are shipped."""
