"""Studies that stand on the library: the resonance of a dimer, which `gx.resonance` names."""
