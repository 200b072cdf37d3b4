"""The SX-2 vehicle."""
