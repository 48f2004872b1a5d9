"""Error of a model on recordings, and where it sits."""
