"""The nodes of controller and conductor."""
