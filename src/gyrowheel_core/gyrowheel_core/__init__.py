"""What every package uses, and no physics: errors, units, files, topics, the shell of a node."""

__version__ = "0.1.0"
