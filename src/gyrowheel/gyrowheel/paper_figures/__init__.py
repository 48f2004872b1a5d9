"""The published ground test: every statement of the paper, and the number that this project computes."""
