"""Drag estimates: DC voltages of holds next to simulated torques."""
