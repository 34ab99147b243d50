"""A sweep that stands in a TOML file, for `granjax sweep FILE.toml`."""

from .recipe import Recipe, recipe, recipe_of
from .text import tables

__all__ = ["Recipe", "recipe", "recipe_of", "tables"]
