from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from jaxtyping import Complex
from refusals import refused

import granjax as gx
from granjax.orbits import Bifurcation
from granjax.results import Result, array, note, part


class Sample(Result):
    _else: ClassVar = "SI"
    ts: object = array("The times.", "s", "time", name="time")
    us: object = array("The displacements.", "m", "time site", name="u")
    roots: Complex[np.ndarray, " root"] = array("The roots.")
    outcome: str = "Found."
    count: int = 3
    missing: object = None


@pytest.fixture
def sample():
    fields = {"bead": jnp.zeros((4, 3)), "resonator": jnp.ones((4, 2))}
    return Sample(np.linspace(0.0, 1.0, 4), fields, np.array([1j, 2.0]))


def test_lanes_of_a_spectrum_are_named_beside_coordinates_that_they_share():
    found = gx.measures.spectrum(np.ones((8, 4, 3)), 0.1)
    assert found.to_xarray().power.dims == ("k", "omega", "lane")
    assert found.to_xarray(lanes={"ratio": [1, 2, 3]}).power.dims == ("k", "omega", "ratio")


def test_a_result_has_named_axes_units_and_an_origin(sample):
    data = sample.to_xarray()
    assert data.u_bead.dims == ("time", "site_bead") and data.u_resonator.dims == (
        "time",
        "site_resonator",
    )
    assert data.time.attrs["units"] == "s" and data.u_bead.attrs["units"] == "m"
    assert data.roots_imag.values.tolist() == [1.0, 0.0] and data.roots_real.dims == ("root",)
    wanted = {
        "result": "Sample",
        "outcome": "Found.",
        "granjax": gx.__version__,
        "jax": jax.__version__,
        "count": 3,
    }
    assert wanted.items() <= data.attrs.items() and not any("held" in name for name in data.attrs)


def test_a_field_says_what_it_is_once(sample):
    data = sample.to_xarray()
    assert data.time.attrs == {"units": "s", "long_name": "time", "description": "The times."}
    assert data.u_bead.attrs["description"] == "The displacements."
    told = "- `roots` (root): The roots."
    assert told in Sample.__doc__ and "- `ts` (time) [s]: The times." in Sample.__doc__


def test_a_result_is_read_back_from_its_file(sample, tmp_path):
    again = xr.load_dataset(sample.save(tmp_path / "sample.NC"), engine="h5netcdf")
    assert again.equals(sample.to_xarray()) and again.attrs["outcome"] == "Found."
    from scipy.io import loadmat

    matlab = loadmat(sample.save(tmp_path / "sample.mat"))
    assert np.array_equal(matlab["u_resonator"], np.ones((4, 2)))
    with refused("ends in .nc or .mat"):
        sample.save(tmp_path / "sample.txt")


def test_a_flipped_bit_of_an_array_is_found(tmp_path):
    us = np.random.default_rng(0).normal(size=(4, 3))
    path = Sample(np.linspace(0.0, 1.0, 4), us, np.array([1j, 2.0])).save(tmp_path / "sample.nc")
    content = bytearray(path.read_bytes())
    content[content.index(us.tobytes()) + 40] ^= 1
    path.write_bytes(content)
    with pytest.raises(OSError):
        xr.load_dataset(path)


@pytest.mark.slow
def test_axes_that_share_a_size_share_a_name_and_no_others():
    inside = gx.Bond(gx.Shift(0, "periodic", ("bead", "core")), gx.Linear(0.3))
    masses = {"bead": np.ones(6), "core": np.full(6, 0.5)}
    chain = gx.Lattice(masses, (gx.Bond(gx.Shift(1, "periodic", "bead"), gx.Linear(1.0)), inside))
    flat = gx.linear.dispersion(chain, jnp.linspace(0.1, 3.0, 5)).to_xarray()
    assert flat.omega.dims == flat.group_velocity.dims == ("wave", "band")
    assert flat.vectors_real.dims == ("wave", "field", "site", "band")
    assert flat.field.values.tolist() == ["bead", "core"]
    bonds = [gx.Bond(gx.Shift(way, "periodic"), gx.Linear(1.0)) for way in ((1, 0), (0, 1))]
    plane = gx.Lattice(np.ones((6, 5)), tuple(bonds))
    data = gx.linear.dispersion(plane, jnp.ones((5, 2))).to_xarray()
    assert data.k.dims == ("wave", "k_1") and data.group_velocity.dims == (
        "wave",
        "band",
        "group_velocity_2",
    )
    assert (
        data.vectors_real.dims[:3] == ("wave", "site", "site_1")
        and data.vectors_real.dims[-1] == "band"
    )
    one = gx.linear.dispersion(gx.scenes.dimer(12, precompression=1.0), 1.0).to_xarray()
    assert one.omega.dims == one.group_velocity.dims == ("band",) and one.vectors_real.dims == (
        "site",
        "band",
    )
    modes = gx.linear.normal_modes(plane).to_xarray()
    assert modes.modes.dims[:2] == ("site", "site_1") and modes.modes.dims[-1] == "mode"


class Rich(Result):
    state: gx.State = part(axes="site")
    changes: tuple[Bifurcation, ...] = array(axes="change")
    first: Sample
    second: Sample
    parts: Sample = note()
    outcome: str = "Found."


def test_fields_of_a_state_records_and_results_within_are_kept(sample, tmp_path):
    state = gx.State(*({"bead": jnp.zeros(3), "resonator": jnp.ones(2)} for _ in "uv"))
    longer = Sample(np.linspace(0.0, 1.0, 5), jnp.ones((5, 3)), sample.roots)
    for changes in ((), (Bifurcation("fold", 0.5, 1), Bifurcation("torus", 0.75, 3, None, 1j))):
        rich = Rich(state, changes, sample, longer, sample)
        again = xr.load_dataset(rich.save(tmp_path / f"{len(changes)}.nc"))
        rich.save(tmp_path / "rich.mat")
        assert again.equals(rich.to_xarray()) and not any(
            x.startswith("parts") for x in again.variables
        )
        assert (
            again.changes_kind.values.tolist() == [b.kind for b in changes]
            and "changes" not in again.attrs
        )
        assert again.changes_p.values.tolist() == [
            b.p for b in changes
        ] and again.changes_p.dims == ("change",)
        assert again.state_v_bead.dims == ("site_bead",) and again.state_v_resonator.dims == (
            "site_resonator",
        )
        assert again.first_u_bead.dims == ("first_time", "site_bead") and again.second_u.dims == (
            "second_time",
            "site",
        )
        assert again.second_time.size == 5 and again.attrs["second_outcome"] == "Found."


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
        with refused("traced"):
            traced.to_xarray()
        return ts

    jax.jit(inside)(jnp.zeros(4))


def test_a_result_without_an_outcome_cannot_be_made():
    class Mute(Result):
        x: object

    with pytest.raises(TypeError, match="outcome"):
        Mute(1.0)
