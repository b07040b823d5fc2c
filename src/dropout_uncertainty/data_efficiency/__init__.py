"""Thesis section 5.4, data efficiency in deep reinforcement learning: the cart-pole, PILCO, Deep PILCO and others.

The others: their ablations, learners without a model, and a recurrent model where the state is hidden.
"""
