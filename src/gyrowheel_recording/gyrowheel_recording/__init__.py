"""Recordings: bags, tables of other formats, column maps, and columns that are not what their names state."""
