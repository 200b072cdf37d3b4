"""Floor 1: planet, atmosphere, wind, aerodynamics, vehicle."""
