"""The nodes of drag estimator, recorder and replay."""
