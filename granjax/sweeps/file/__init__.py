"""A sweep that stands in a TOML file, for `granjax sweep FILE.toml`."""

from .recipe import Recipe, recipe

__all__ = ["Recipe", "recipe"]
