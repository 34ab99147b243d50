"""What tells one function from another."""

from collections.abc import Callable


def function_identity(function: Callable) -> dict:
    """The name of a function."""
    return {"name": getattr(function, "__qualname__", type(function).__name__)}
