"""Many recordings, each diagnosed alone: a row of a table for each."""
