"""MCAP files: format, reader, writer."""
