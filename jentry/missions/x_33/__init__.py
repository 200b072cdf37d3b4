"""The X-33-like vehicle of Lee, Cho and Yan: its aerodynamics and angle of attack."""
