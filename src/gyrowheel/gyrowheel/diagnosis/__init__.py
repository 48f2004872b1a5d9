"""Effects that a model lacks."""
