"""The graph of nodes: sessions that start the nodes of the bench, and what viewers need."""

__version__ = "0.1.0"
