"""Reports: pictures and documents made from results."""
