"""DC voltages next to simulated torques."""
