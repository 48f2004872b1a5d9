"""Estimation of parameters that the user chooses."""
