"""Angular momentum that the wheel can store and exchange."""
