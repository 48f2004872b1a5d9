"""The published ground test, statement by statement: what the paper says, and what this project computes."""
