"""Sealed machines: the key of a hidden machine, and the one judge of an answer."""
