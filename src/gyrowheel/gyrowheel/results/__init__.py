"""What the functions of the Python API return: immutable results, one module each."""
