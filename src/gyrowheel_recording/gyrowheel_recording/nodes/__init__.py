"""The recorder and the replay node."""
