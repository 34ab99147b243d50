"""In a notebook: a scene under sliders, with a space-time map that follows them."""

from .explorer import Explorer, explore

__all__ = ["Explorer", "explore"]
