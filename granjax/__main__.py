"""`python -m granjax`."""

from .cli import command

command()
