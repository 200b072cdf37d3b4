"""`python -m jentry` is the command `jentry`."""

from .cli import process


process()
