"""From the records of Deep Sea to numbers and pictures."""
