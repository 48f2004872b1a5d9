"""Errors that a user can cause or meet."""

from gyrowheel_core.errors import InputError, one_line, printable

__all__ = ["InputError", "one_line", "printable"]
