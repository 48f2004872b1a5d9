"""Readers of tables, one module a format."""
