"""From records of section 5.4 to numbers, statements, figures and animations."""
