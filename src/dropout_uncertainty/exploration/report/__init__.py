"""From records of section 5.3 to numbers, statements, figures and animations."""
