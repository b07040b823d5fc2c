"""Deep PILCO: a dropout network as the model, particles to plan with it (Algorithm 4)."""
