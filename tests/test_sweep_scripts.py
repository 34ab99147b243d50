"""What a user's sweep looks like: whole scripts of fewer than 12 lines, figure included."""

import numpy as np
import pytest

import granjax as gx

CRYSTAL = """\
import granjax as gx, numpy as np

def transmitted(first, second):
    chain = gx.scenes.beads("steel 316", [9.5e-3, first, second], cells=14)
    force = gx.Peak(gx.measures.contact_force)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.5), 3e-3, record={"force": force})
    return run.recorded["force"][-1]

radii = np.linspace(4e-3, 12e-3, 20)
data = gx.sweep(transmitted, {"first": radii, "second": radii}, units={"first": "m", "second": "m", "transmitted": "N"})
gx.plots.save(gx.plots.sweep(data), "crystal.png")
"""

BREATHERS = """\
import granjax as gx, numpy as np

def breather(ratio):
    chain = gx.scenes.dimer(21, ratio, precompression=1.0, boundary="free")
    orbit = gx.breathers.breather(chain, 0.988 * (3 / ratio) ** 0.5)
    return {"energy": orbit.energy, "verdict": orbit.floquet().verdict}

data = gx.sweep(breather, {"ratio": np.linspace(0.3, 0.6, 64)}, store="breathers.zarr")
gx.plots.save(gx.plots.sweep(data, "energy", bands="verdict"), "breathers.png")
"""

FITS = """\
import granjax as gx, numpy as np

def fitted(trace):
    scene = lambda p: gx.scenes.monomer(8, stiffness=p["stiffness"], precompression=0.1)
    measured = gx.Traces.from_csv(f"trace{trace}.csv", velocity=[1, 2], sites=[3, 6], sigma=0.01)
    fit = gx.fit(scene, {"stiffness": 1.2}, measured, state=lambda p, chain: gx.states.impact(chain))
    return {"stiffness": fit.parameters["stiffness"], "stiffness_error": fit.covariance[0, 0] ** 0.5}

data = gx.sweep(fitted, {"trace": range(32)})
gx.plots.save(gx.plots.sweep(data, "stiffness"), "fits.png")
"""


def lines(script):
    return [line for line in script.splitlines() if line.strip()]


def run(script):
    """What a script leaves."""
    space = {"__name__": "script"}
    exec(compile(script, "script.py", "exec"), space)
    return space


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_they_are_short():
    assert all(len(lines(script)) < 12 for script in (CRYSTAL, BREATHERS, FITS))


@pytest.mark.study
def test_radii_of_a_crystal(folder):
    space = run(CRYSTAL)
    data = space["data"]
    assert (data.reason == "").all() and (folder / "crystal.png").stat().st_size > 5000
    assert data.first.attrs["units"] == "m" and data.transmitted.attrs["units"] == "N"
    assert data.transmitted.size == 400 and data.transmitted.min() > 1e-6
    # a lane is its run alone, to the error of its steps
    at = data.isel(first=-1, second=1)
    alone = space["transmitted"](float(at.first), float(at.second))
    assert float(at.transmitted) == pytest.approx(float(alone), rel=1e-3)


@pytest.mark.study
def test_breathers_over_mass_ratios(folder):
    """What failed says why: near 0.6 the gap is too narrow for a breather in 21 beads."""
    data = run(BREATHERS)["data"]
    assert (folder / "breathers.zarr").is_dir() and (folder / "breathers.png").stat().st_size > 5000
    good = (data.reason == "").values
    assert np.isfinite(data.energy.values[good]).all() and good[:40].all() and not good[-1]
    assert set(data.verdict.values[good]) == {"stable", "unstable"}
    assert all(str(why).startswith("Not localised") for why in data.reason.values[~good])


@pytest.mark.study
def test_fits_of_traces(folder):
    """Traces of chains whose stiffness rises by 0.02 from one to the next."""
    times, draw = np.linspace(0.0, 12.0, 97), np.random.default_rng(0)
    for k in range(32):
        chain = gx.scenes.monomer(8, stiffness=1.0 + 0.02 * k, precompression=0.1)
        vs = np.asarray(gx.simulate(chain, gx.states.impact(chain), 12.0, save_at=97).vs)
        noisy = vs[:, [3, 6]] + 0.01 * draw.standard_normal((97, 2))
        np.savetxt(
            folder / f"trace{k}.csv",
            np.column_stack([times, noisy]),
            delimiter=",",
            header="Time (s),a (m/s),b (m/s)",
            comments="",
        )
    data = run(FITS)["data"]
    assert (data.reason == "").all() and data.sizes["trace"] == 32
    assert (folder / "fits.png").is_file()
    off = (data.stiffness - 1.0 - 0.02 * data.trace) / data.stiffness_error
    assert np.abs(off).max() < 4
