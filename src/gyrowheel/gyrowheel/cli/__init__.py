"""The command line: the application, and the shared parts of the verbs."""
