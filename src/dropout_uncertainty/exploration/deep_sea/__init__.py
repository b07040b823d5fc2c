"""Deep Sea (Osband et al.): a world in which only an agent that explores on purpose finds the reward."""
