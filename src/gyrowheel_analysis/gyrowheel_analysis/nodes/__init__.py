"""The nodes ``drag_estimator``, ``recorder`` and ``replay``."""
