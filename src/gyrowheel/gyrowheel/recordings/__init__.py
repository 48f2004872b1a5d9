"""Recordings: open, summarise, salvage, correct."""
