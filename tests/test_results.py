from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.results import Held, Result


class Sample(Result):
    held: ClassVar = {"ts": Held("time", "s", "time"), "us": Held("time site", "m", "u"), "roots": Held("root")}
    ts: object
    us: object
    roots: object
    outcome: str = "Found."
    count: int = 3
    missing: object = None


@pytest.fixture
def sample():
    fields = {"bead": jnp.zeros((4, 3)), "resonator": jnp.ones((4, 2))}
    return Sample(np.linspace(0.0, 1.0, 4), fields, np.array([1j, 2.0]))


def test_a_result_has_named_axes_units_and_an_origin(sample):
    data = sample.to_xarray()
    assert data.u_bead.dims == ("time", "site_bead") and data.u_resonator.dims == ("time", "site_resonator")
    assert data.time.attrs["units"] == "s" and data.u_bead.attrs["units"] == "m"
    assert data.roots_imag.values.tolist() == [1.0, 0.0] and data.roots_real.dims == ("root",)
    wanted = {"result": "Sample", "outcome": "Found.", "granjax": gx.__version__, "jax": jax.__version__, "count": 3}
    assert wanted.items() <= data.attrs.items() and not any("held" in name for name in data.attrs)


def test_a_result_is_read_back_from_its_file(sample, tmp_path):
    again = Result.load(sample.save(tmp_path / "sample.nc"))
    assert again.equals(sample.to_xarray()) and again.attrs["outcome"] == "Found."
    from scipy.io import loadmat

    matlab = loadmat(sample.save(tmp_path / "sample.mat"))
    assert np.array_equal(matlab["u_resonator"], np.ones((4, 2)))
    with pytest.raises(ValueError, match="ends in .nc or .mat"):
        sample.save(tmp_path / "sample.txt")


def test_a_result_prints_numbers_and_ranges(sample):
    lines = dict(line.split(maxsplit=1) for line in str(sample).splitlines())
    assert lines["outcome"] == "Found." and lines["count"] == "3" and "missing" not in lines
    assert lines["ts"] == "0, 0.333333, 0.666667, 1 s"
    assert lines["us"] == "bead: shape (4, 3), 0 ... 0 m, resonator: shape (4, 2), 1 ... 1 m"
    assert "f64" not in str(sample)


def test_a_traced_result_prints_and_is_not_written(sample):
    def inside(ts):
        traced = Sample(ts, sample.us, sample.roots)
        assert repr(traced) == "Sample(traced)"
        with pytest.raises(ValueError, match="traced"):
            traced.to_xarray()
        return ts

    jax.jit(inside)(jnp.zeros(4))


def test_a_result_without_an_outcome_cannot_be_made():
    class Mute(Result):
        x: object

    with pytest.raises(TypeError, match="outcome"):
        Mute(1.0)


def test_a_run_is_written_with_its_records_and_statistics(tmp_path):
    lattice = gx.scenes.monomer(8, precompression=1.0)
    record = {"peak": gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y))}
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=0.1), 1.0, save_at=4, record=record)
    data = Result.load(run.save(tmp_path / "run.nc"))
    assert data.u.dims == ("time", "site") and data.u.attrs["units"] == "m" and data.v.shape == (4, 8)
    assert data.peak.dims == ("peak_0",) and np.array_equal(data.time, run.ts)
    assert data.attrs["solver"] == "SRKN11b" and data.attrs["stats_steps"] == int(run.stats["steps"])
    assert data.attrs["contact_opened"] == 0 and data.attrs["outcome"] == run.outcome
