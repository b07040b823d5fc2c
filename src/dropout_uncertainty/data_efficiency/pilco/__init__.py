"""PILCO: a Gaussian process as the model, moment matching to plan with it (Algorithm 3)."""
