"""Results as people read them: tables and sentences for the terminal, in the units of the workshop."""
