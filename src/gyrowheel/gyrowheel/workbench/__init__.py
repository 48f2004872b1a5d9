"""The workbench: recordings, where a model fails on them, what is missing, add, undo; in a browser on this computer."""
