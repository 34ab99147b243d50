"""The command line: `granjax resonance`."""

from .commands import command, main
from .output import UNREAD

__all__ = ["UNREAD", "command", "main"]
