"""Ready scenes: functions that return a `Lattice`, or compose one."""

from .chains import dimer, fput, monomer, pattern, toda

__all__ = ["dimer", "fput", "monomer", "pattern", "toda"]
