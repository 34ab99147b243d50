"""Canonical scenes: a test set of lattice problems with references far below the error of any run in double precision.

    scene = gx.canonical.scene("impact")
    run = gx.simulate(scene.lattice, scene.state, scene.t1, t0=scene.t0)
    error = scene.error(run.final)

Every reference was calculated twice, by two unrelated methods in 80-bit numbers; `python
benchmarks/make_references.py` makes them again.
"""

from .scenes import Scene, names, scene

__all__ = ["Scene", "names", "scene"]
