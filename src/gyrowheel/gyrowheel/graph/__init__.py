"""The running bench: nodes, replay, viewers."""
