"""Results as they leave the program: the JSON contract of each verb."""
