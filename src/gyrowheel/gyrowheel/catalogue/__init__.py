"""Shipped effects, benches and test plans."""
