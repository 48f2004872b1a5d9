"""Results of many recordings over time and machine."""
