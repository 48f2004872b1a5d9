"""The node ``drag_estimator``."""
