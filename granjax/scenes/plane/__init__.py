"""Named lattices of the plane, and chains with several sites per cell."""
