"""`python -m jentry` is the command `jentry`."""

from .cli import main


main()
