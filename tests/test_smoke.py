"""Every public capability once, small and by its number: what a version of a dependency can break.

`.ci/run` runs this file with the lowest versions that are declared, and with the newest on newer Pythons.
"""

import os
import subprocess
import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

import granjax as gx
from granjax.__main__ import main

pytestmark = pytest.mark.smoke
BEADS = 6


@pytest.fixture(scope="module")
def chain():
    return gx.scenes.dimer(BEADS, ratio=0.5)


@pytest.fixture(scope="module")
def pressed():
    return gx.scenes.pattern(7, (1.0, 2.96), precompression=1.0, boundary="free")


@pytest.fixture(scope="module")
def run(chain):
    force = gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y))
    return gx.simulate(chain, gx.states.impact(chain), 5.0, save_at=20, record={"force": force})


def test_a_run_keeps_its_energy_and_finds_its_records(run):
    assert (
        run.us.shape == (20, BEADS)
        and run.energy_error < 1e-3
        and run.outcome.startswith("Completed")
    )
    assert 0.5 < float(run.recorded["force"].max()) < 1.0


@pytest.mark.parametrize(
    "solver", [gx.VelocityVerlet(), gx.SRKN11b(), gx.KahanLi8(), gx.SofroniouSpaletta10()]
)
def test_solvers_agree(run, chain, solver):
    found = gx.simulate(chain, gx.states.impact(chain), 5.0, solver=solver, step=0.01)
    assert_allclose(found.final.v, run.final.v, atol=2e-3)


@pytest.mark.parametrize("solver", [gx.RKN86(), gx.RKN1210()])
def test_adaptive_solvers_agree(run, chain, solver):
    found = gx.simulate(chain, gx.states.impact(chain), 5.0, solver=solver, tolerance=1e-8)
    assert_allclose(found.final.v, run.final.v, atol=2e-3)


def test_diffrax_s_own_solver_agrees(run, chain):
    found = gx.simulate(chain, gx.states.impact(chain), 5.0, solver=diffrax.Tsit5(), tolerance=1e-8)
    assert_allclose(found.final.v, run.final.v, atol=2e-3)


def test_a_long_chain_on_all_cores():
    chain = gx.scenes.monomer(20_000)
    run = gx.simulate(chain, gx.states.impact(chain), 1.0)
    assert run.energy_error < 1e-3


def test_a_batch_has_its_lanes_last():
    chains = jax.vmap(lambda ratio: gx.scenes.dimer(BEADS, ratio=ratio), out_axes=-1)(
        jnp.linspace(0.4, 1.0, 3)
    )
    run = gx.simulate(chains, gx.states.impact(chains), 5.0)
    one = gx.scenes.dimer(BEADS, ratio=0.7)
    assert_allclose(
        run.final.u[:, 1], gx.simulate(one, gx.states.impact(one), 5.0).final.u, atol=1e-3
    )


@pytest.mark.parametrize("adjoint", [None, gx.Reversible()])
def test_gradients_are_those_of_differences(adjoint):
    def peak(ratio):
        chain = gx.scenes.dimer(BEADS, ratio=ratio)
        return gx.simulate(chain, gx.states.impact(chain), 2.0, step=0.01, adjoint=adjoint).final.v[
            2
        ]

    slope = (peak(0.5 + 1e-5) - peak(0.5 - 1e-5)) / 2e-5
    assert jax.grad(peak)(0.5) == pytest.approx(float(slope), rel=1e-5)
    if adjoint is None:
        assert jax.jvp(peak, (0.5,), (1.0,))[1] == pytest.approx(float(slope), rel=1e-5)


def test_float32(chain):
    small = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), chain)
    run = gx.simulate(small, gx.states.impact(small), 5.0)
    assert run.final.u.dtype == jnp.float32 and run.energy_error < 1e-2


def test_linear_theory(pressed):
    modes = gx.linear.normal_modes(pressed)
    assert modes.omega.shape == (7,) and modes.omega[0] == pytest.approx(0, abs=1e-6)
    assert len(gx.linear.bands(pressed).gaps) == 1


def test_a_breather_a_family_and_multipliers(pressed):
    edge = 3**0.5  # of the optical band, which begins at K2 / m
    family = gx.breathers.family(pressed, until=0.985 * edge)
    assert family.omega[-1] == pytest.approx(0.985 * edge) and family.verdict[0] == "stable"
    breather = gx.breathers.breather(pressed, 0.98 * edge, family.orbit(-1))
    found = breather.floquet()
    assert breather.residual < 1e-9 and np.prod(found.multipliers) == pytest.approx(1, abs=1e-8)
    gx.plots.floquet_circle(found)
    gx.plots.branch(family)


def test_forced_orbits_and_what_a_laboratory_sees():
    chain = gx.scenes.monomer(3, precompression=1.0)
    omega = 1.2

    def shaken(omega):
        return gx.driven.driven_chain(chain, 0.02, omega, damping=0.2)

    orbit = gx.forced.forced_orbit(shaken(omega), 2 * np.pi / omega)
    settled = gx.driven.settle(shaken(omega), gx.states.rest(chain), 2 * np.pi / omega)
    assert orbit.residual < 1e-9 and settled.settled
    assert_allclose(settled.state.u, orbit.state.u, atol=1e-4)
    branch = gx.forced.forced_branch(shaken, omega, 1.3, period=lambda omega: 2 * np.pi / omega)
    assert "reached" in branch.outcome and set(branch.verdict) == {"stable"}


def struck(p, lattice):
    return gx.states.impact(lattice, velocity=0.5)


def of_stiffness(p):
    law = gx.Hertz(p["stiffness"], 1.0)
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), law),), sites=4)


def test_a_fit_finds_what_made_the_data(tmp_path):
    times = np.linspace(0, 4, 21)
    true = of_stiffness({"stiffness": 1.2})
    run = gx.simulate(true, struck(None, true), 4.0, save_at=times)
    np.savetxt(
        tmp_path / "run.csv",
        np.c_[times, run.vs[:, 1:3]],
        delimiter=",",
        header="time,a,b",
        comments="",
    )
    traces = gx.Traces.from_csv(
        tmp_path / "run.csv",
        time="time",
        velocity=["a", "b"],
        sites=[1, 2],
        units={"time": "s", "a": "m/s", "b": "m/s"},
        sigma=1e-3,
    )
    fit = gx.fit(of_stiffness, {"stiffness": 1.0}, traces, state=struck)
    assert fit.parameters["stiffness"] == pytest.approx(1.2, rel=1e-4)


def test_a_design_lowers_its_objective():
    def highest(p):
        return gx.linear.normal_modes(of_stiffness(p)).omega[-1]

    found = gx.design(
        highest, {"stiffness": 1.0}, bounds={"stiffness": (0.5, 2.0)}, max_steps=20, throw=False
    )
    assert found.value < found.start_value and found.parameters["stiffness"] < 0.6


def test_work_precision_advises(chain):
    solvers = [gx.VelocityVerlet(), gx.SRKN6b()]
    table = gx.work_precision(
        chain, gx.states.impact(chain), 2.0, solvers=solvers, steps=[0.1, 0.05]
    )
    assert table.advice(1e-3).error < 1e-3 and "0.001" in repr(table.advice(1e-3))


def test_results_are_written_read_and_drawn(run, tmp_path):
    run.save(tmp_path / "run.nc")
    with xr.open_dataset(tmp_path / "run.nc") as data:
        np.testing.assert_array_equal(data["u"], run.us)
    run.save(tmp_path / "run.mat")
    ax = gx.plots.space_time(run)
    ax.figure.savefig(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 1000 and (
        tmp_path / "run.mat"
    ).stat().st_size > 1000


def test_a_process_of_its_own_with_granjax_s_flags():
    code = (
        "import granjax as gx; chain = gx.scenes.dimer(6); run = gx.simulate(chain, gx.states.impact(chain), 2.0); "
        "gx.clear(); print(run.final.u.dtype, run.outcome, gx.tune().outcome)"
    )
    own = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=own
    )
    assert done.stdout.startswith("float64 Completed")


def test_the_command_line(tmp_path, capsys):
    assert not main(["resonance", "--beads", "11", "--ratios", "12", "--out", str(tmp_path)])
    assert "transmission" in capsys.readouterr().out
    assert list(tmp_path.glob("*.nc")) and list(tmp_path.glob("*.png"))


def test_a_sweep_is_kept_and_read_in_both_formats(tmp_path):
    def struck(ratio, beads):
        chain = gx.scenes.dimer(beads, ratio=ratio)
        run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.02)
        return {"last": run.final.v[-1], "wave": jnp.exp(1j * ratio)}

    parameters = {"ratio": [0.4, 0.7, 1.2], "beads": [3, 4]}
    data = gx.sweep(
        struck, parameters, store=tmp_path / "struck.zarr", units={"last": "m/s"}, progress=False
    )
    again = gx.sweep(
        struck, parameters, store=tmp_path / "struck.zarr", units={"last": "m/s"}, progress=False
    )
    one = struck(jnp.asarray(0.7), 4)["last"]
    assert data.identical(again) and float(data.last.sel(ratio=0.7, beads=4)) == pytest.approx(
        float(one), rel=1e-9
    )
    assert "expected numbers in (0, 1]" in str(data.reason[2, 0].values) and data.sel(
        beads=3
    ).last.shape == (3,)
    np.testing.assert_array_equal(
        xr.open_zarr(tmp_path / "struck.zarr").last.values, data.last.values
    )
    assert gx.plots.sweep(data, "last").lines or gx.plots.sweep(data, "last").collections
    each = gx.sweep(
        lambda x, kind: {"kind": kind, "x": float(x)}, {"x": [1.0], "kind": ["a"]}, executor=None
    )
    assert each.kind_found.item() == "a" and each.x_found.item() == 1.0
