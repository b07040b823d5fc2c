"""From records of section 5.2 to numbers, statements and figures."""
