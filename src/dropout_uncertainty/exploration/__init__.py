"""Section 5.3: exploration by weight draws in a 2D world, held for one decision or longer, and in Deep Sea."""
