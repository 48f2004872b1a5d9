"""Diagnosis and tests in turn until the verdict is settled."""
