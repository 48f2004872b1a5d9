"""Least squares of a model on recordings: the problem, its noise, drift and terms."""
