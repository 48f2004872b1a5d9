"""What is left of the error: table of errors, maps, regions, dependence on variables."""
