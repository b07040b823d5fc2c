"""DDPG and NAF: learners without a model of the dynamics, as in the right half of thesis Figure 5.7."""
