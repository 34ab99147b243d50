"""The command line: `granjax resonance`, `granjax sweep`, `granjax reproduce`, `granjax bench`."""

from .commands import command, main
from .output import UNREAD

__all__ = ["UNREAD", "command", "main"]
