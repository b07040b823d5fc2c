"""From the records of the ablations to numbers, statements and figures."""
