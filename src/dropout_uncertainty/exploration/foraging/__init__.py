"""The 2D foraging world of section 5.3, as an environment and as a picture."""
