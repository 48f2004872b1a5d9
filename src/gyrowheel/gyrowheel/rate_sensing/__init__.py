"""The wheel as a two-axis rate sensor."""
