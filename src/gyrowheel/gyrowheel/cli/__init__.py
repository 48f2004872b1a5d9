"""The command line: the application, and what the verbs share."""
