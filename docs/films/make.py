"""The films of the front page: `python docs/films/make.py [NAME ...]` writes them beside this file."""

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import granjax as gx

HERE = Path(__file__).parent
FRAMES, COLOURS = 36, 40


def keep(name, film, width, height, low=None):
    """Write a film, small, with one palette for all of its frames; `low`: where the axis of a chain begins."""
    film._fig.set_size_inches(width, height)
    if low is not None:
        film._fig.axes[0].set_ylim(bottom=low)
    path = HERE / f"{name}.webp"
    with Image.open(io.BytesIO(gx.plots.drawn(film, ".gif", dpi=90))) as made:
        delay, frames = made.info["duration"], []
        for i in range(made.n_frames):
            made.seek(i)
            frames.append(made.convert("RGB"))
    sample = Image.fromarray(np.concatenate([np.asarray(x) for x in frames[::5]]))
    palette = sample.quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    entries = np.array(palette.getpalette()).reshape(-1, 3)
    entries[entries.sum(1).argmax()] = 255  # the ground
    palette.putpalette(entries.ravel().tolist())
    frames = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in frames]
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=delay,
        loop=0,
        lossless=True,
        quality=100,
        method=6,
    )
    print(
        f"{path.name}: {path.stat().st_size / 1000:.0f} kB, {len(frames)} frames of {frames[0].size}"
    )


def resonance():
    """A pulse that leaves energy behind at every light bead: a dimer at its first resonance."""
    chain = gx.scenes.dimer(81, ratio=0.59)
    run = gx.simulate(chain, gx.states.impact(chain), 92.0, save_at=FRAMES)
    force = np.asarray(gx.measures.along(gx.measures.contact_force, chain, run))
    keep(
        "resonance",
        gx.plots.film(run, quantity=force, label="contact force", rate=10),
        4.0,
        2.4,
        -0.02,
    )


def breather():
    """A breather of a dimer under load, over one period."""
    chain = gx.scenes.pattern(41, (1.0, 2.96), precompression=1.0, boundary="free")
    orbit = gx.breathers.breather(chain, 0.985 * 3**0.5)
    run = gx.simulate(chain, orbit.state, float(orbit.period) * (1 - 1 / FRAMES), save_at=FRAMES)
    keep("breather", gx.plots.film(run, quantity="u", rate=18), 4.0, 2.4)


def shock():
    """A dispersive shock of a Toda lattice whose halves collide: the strain."""
    problem = gx.shocks.velocity_shock(gx.scenes.toda(140, boundary="free"), 0.5)
    run = problem.run(44.0, save_at=FRAMES)
    strain = np.asarray(gx.measures.along(gx.measures.strain, problem.lattice, run))
    keep("shock", gx.plots.film(run, quantity=strain, label="strain", rate=10), 4.0, 2.4, -0.05)


def packing():
    """A struck hexagonal packing of steel beads, coloured by speed."""
    crystal = gx.scenes.packing("steel 316", 5e-3, 7, outline="hexagon")
    struck = gx.states.impact(crystal, [0.3, 0.0], site=crystal.shape[0] // 2)
    run = gx.simulate(crystal, struck, 2.4e-4, save_at=32)
    keep("packing", gx.plots.film(run, crystal, limit=0.08, label="speed", rate=10), 3.6, 2.9)


if __name__ == "__main__":
    for name in sys.argv[1:] or ("resonance", "breather", "shock", "packing"):
        globals()[name]()
