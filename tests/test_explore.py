"""Sliders and their map, without a notebook: what moves, what is refused, what is compiled; the rest in a kernel."""

import sys

import jax
import numpy as np
import pytest
from cases import heard as _heard
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.plots import explore as module

ipywidgets = pytest.importorskip("ipywidgets")


@pytest.fixture
def notebook(monkeypatch):
    """As in a kernel: widgets that are shown."""
    monkeypatch.setattr(module, "_widgets", lambda: ipywidgets)


def shown(explorer):
    return np.asarray(explorer.figure.axes[0].images[0].get_array())


def dimer(ratio, precompression):
    return gx.scenes.dimer(8, ratio, precompression=precompression)


@pytest.fixture
def explorer(notebook):
    return gx.explore(dimer, 6.0, frames=12)


@pytest.mark.slow
def test_the_map_follows_and_nothing_compiles(explorer):
    assert explorer.values == {"ratio": 0.5, "precompression": 0.0, "amplitude": 1.0}
    assert_allclose(shown(explorer), explorer.run.vs)
    # once more, by programs for a map of one sign or of both
    explorer.move(precompression=0.25)
    for values in ({"ratio": 0.3}, {"precompression": 0.5, "amplitude": 0.1}, {"ratio": 1.0}):
        heard = len(_heard)
        explorer.move(**values)
        now = explorer.values
        assert values.items() <= now.items() and len(_heard) == heard
        chain = dimer(now["ratio"], now["precompression"])
        run = gx.simulate(chain, gx.states.impact(chain, now["amplitude"]), 6.0, save_at=12)
        assert_allclose(shown(explorer), run.vs, atol=1e-9 * now["amplitude"])
        assert_allclose(explorer.lattice.mass, chain.mass)
    # as a front end does: a slider's value is set
    explorer.sliders["ratio"].value = 0.25
    assert_allclose(explorer.lattice.mass[1], 0.25)


@pytest.mark.slow
def test_it_reads_well(explorer):
    text = repr(explorer)
    assert "ratio           0.5" in text and "Completed at t = 6" in text
    bundle = explorer._repr_mimebundle_()
    assert {"application/vnd.jupyter.widget-view+json", "image/png", "text/plain"} <= bundle.keys()
    names = ["ratio", "precompression", "amplitude"]
    assert [slider.description for slider in explorer.sliders.values()] == names


@pytest.mark.slow
def test_what_is_refused_is_said(notebook):
    def scene(ratio, share=1.0):
        if share > 2:
            raise ZeroDivisionError("no share")
        return dimer(ratio, 0.0)

    explorer = gx.explore(scene, 6.0, ratio=(0.5, 1.4), frames=12)
    explorer.move(ratio=0.9)
    for values, sentence in (
        ({"ratio": 1.2}, "ratio: expected numbers in (0, 1], got 1.2."),
        ({"ratio": 0.9, "share": 3.0}, "ZeroDivisionError: no share"),
    ):
        explorer.move(**values)
        assert explorer.said.startswith(sentence)
        assert explorer.run is explorer.lattice is explorer.state is None
    explorer.move(share=1.0)
    assert explorer.said.startswith("Completed") and explorer.run.completed


@pytest.mark.slow
def test_runs_that_stop_are_said(notebook):
    explorer = gx.explore(dimer, 6.0, frames=12)
    explorer._runs["max_steps"] = 20
    explorer.move(precompression=0.8, amplitude=10.0, ratio=0.05)
    assert (
        explorer.said.startswith("Stopped after 20 steps") and np.isnan(shown(explorer)[-1]).all()
    )


@pytest.mark.slow
def test_a_scene_in_si(notebook):
    def beads(precompression=20.0):
        kinds = ["steel 316", "PTFE"]
        return gx.scenes.beads(kinds, 9.5e-3, cells=4, precompression=precompression)

    explorer = gx.explore(beads, quantity="force", frames=12)
    axes = explorer.figure.axes[0]
    assert axes.get_xlabel() == "contact" and axes.get_ylabel() in ("time (ms)", "time (µs)")
    explorer.move(precompression=40.0)
    assert_allclose(shown(explorer)[0], 40.0)
    assert explorer.figure.axes[1].get_ylabel() == "contact force (N)"


@pytest.mark.slow
def test_states_whole_numbers_and_fixed_arguments(notebook):
    explorer = gx.explore(
        gx.scenes.monomer,
        3.0,
        sites=(4, 9),
        precompression=1.0,
        frames=8,
        quantity="u",
        state=lambda lattice: gx.states.rest(lattice)._replace(u=0.1 * np.arange(lattice.sites[0])),
    )
    assert explorer.values == {"sites": 4, "amplitude": 1.0}
    explorer.move(sites=7, amplitude=2.0)
    assert_allclose(shown(explorer)[0], 0.2 * np.arange(7))
    assert_allclose(explorer.state.u, 0.2 * np.arange(7))

    def pair(load):
        chain = gx.scenes.monomer(4, precompression=load)
        return chain, gx.states.impact(chain, 0.5)

    explorer = gx.explore(
        pair, 3.0, load=(0.01, 100.0, "log"), frames=8, quantity=lambda t, y, lattice: y.v**2
    )
    assert explorer.values == {"load": pytest.approx(1.0)}
    assert shown(explorer)[0].max() == pytest.approx(0.25) and np.shape(explorer.run.vs) == (8, 4)


BAD = [
    (lambda: gx.explore(gx.scenes.dimer), "sites: expected a range or a value"),
    (
        lambda: gx.explore(dimer, ration=(0.1, 1)),
        "parameter: expected one of .* Did you mean 'ratio'",
    ),
    (lambda: gx.explore(dimer, ratio=(1.0, 0.1)), "ratio: expected two finite numbers"),
    (lambda: gx.explore(dimer, quantity="w"), "quantity: expected one of"),
    (
        lambda: gx.explore(dimer, quantity=lambda t, y, lattice: y.v[0], frames=8),
        "quantity: expected a number for",
    ),
    (
        lambda: gx.explore(gx.scenes.mass_in_mass, 1.0, sites=3, mass=0.5, stiffness=1.0, frames=8),
        r"Such as quantity=lambda t, y, lattice: y\.v\['bead'\]",
    ),
    (lambda: gx.explore(dimer, ratio=1.5, frames=8), "ratio: expected numbers in"),
    (
        lambda: gx.explore(
            lambda load=1.0: jax.vmap(lambda r: dimer(r, load), out_axes=-1)(np.array([0.1, 0.2]))
        ),
        "one lattice at a time",
    ),
    (
        lambda: gx.explore(lambda: gx.scenes.monomer(4), 1.0, state=gx.states.rest),
        "step: expected a time step",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("call", "sentence"), BAD, ids=range(len(BAD)))
def test_what_cannot_be_explored_meets_a_sentence(notebook, call, sentence):
    with refused(sentence):
        call()


def test_a_value_beyond_a_slider_is_refused(explorer):
    for values in ({"ratio": 2.0}, {"rato": 0.5}):
        with refused("expected"):
            explorer.move(**values)


def test_without_a_notebook_it_says_what_to_install(monkeypatch):
    with pytest.raises(ImportError, match=r"needs a notebook.*pip install 'granjax\[notebook\]'"):
        gx.explore(dimer)
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(ImportError, match=r"needs ipywidgets.*pip install 'granjax\[notebook\]'"):
        gx.explore(dimer)
