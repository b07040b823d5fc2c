"""The cart-pole: its dynamics, its cost, and both as a Gymnasium environment."""
