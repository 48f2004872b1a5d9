"""The residual: table of errors, maps, regions, dependence on variables, law."""
