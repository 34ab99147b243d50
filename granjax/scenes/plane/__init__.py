"""Lattices of the plane by name, and chains whose cells have several sites."""
