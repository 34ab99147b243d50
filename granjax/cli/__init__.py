"""The command line: `granjax resonance`, `granjax reproduce`."""

from .commands import command, main
from .output import UNREAD

__all__ = ["UNREAD", "command", "main"]
