"""What blind tests draw and hide; nothing that looks for effects reads it."""
