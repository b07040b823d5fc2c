"""Thesis section 5.4, data efficiency in deep reinforcement learning: the cart-pole, PILCO and Deep PILCO."""
