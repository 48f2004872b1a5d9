"""Torque that coils and motor supply, part by part."""
