"""Torque constants of coils and motor."""
