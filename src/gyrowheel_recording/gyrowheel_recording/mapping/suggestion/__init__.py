"""What a table of others seems to hold."""
