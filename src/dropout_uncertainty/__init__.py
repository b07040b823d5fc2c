"""A checkable reproduction of the applications of dropout uncertainty (chapter 5 of *Uncertainty in Deep Learning*)."""
