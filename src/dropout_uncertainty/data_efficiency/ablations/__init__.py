"""What matters in Deep PILCO: one part changed at a time, looks inside, and times."""
