"""Waves that travel along a lattice without changing their shape."""

from .hertz import hertz_wave

__all__ = ["hertz_wave"]
