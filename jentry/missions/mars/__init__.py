"""The Mars lander: drag tracking in its plane, range tracking in three dimensions."""
