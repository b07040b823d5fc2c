"""``python -m dropout_uncertainty``."""

from dropout_uncertainty.cli import main

main()
