"""The balance of torques and voltages: predicted and measured rows of windows."""
