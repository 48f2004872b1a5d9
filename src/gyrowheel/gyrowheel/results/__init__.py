"""Results that the functions of the Python API return: immutable, one module each."""
