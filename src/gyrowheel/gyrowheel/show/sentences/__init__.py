"""Sentences: the one place where each kind of finding is put into words, for terminal, notebook, report and JSON."""
