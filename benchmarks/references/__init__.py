"""What the references of the canonical scenes are made with: 80-bit equations, integrators, starts."""
