"""What the face shows prints for reading: numbers as numbers, arrays by shape and range, nothing of screens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_exports import legible

import granjax as gx
from granjax.base.printing import numbers
from granjax.base.units import Units

LONG = np.linspace(0.5, 1.0, 400)
CHAIN = gx.scenes.monomer(400, mass=LONG, precompression=1.0)
STEEL = gx.materials.material("steel 316")
PRINTED = {
    "lattice": CHAIN,
    "batch": jax.vmap(lambda r: gx.scenes.dimer(6, ratio=r), out_axes=-1)(LONG),
    "beads": gx.scenes.beads(["steel 316", "PTFE"], 9.5e-3, 10.0),
    "state": gx.states.impact(CHAIN),
    "material": STEEL,
    "stack": gx.materials.stack(["steel 316", "PTFE"]),
    "units": Units(1e-3, 1e-6, 1e-5),
    "traces": gx.Traces(LONG, velocity=np.ones((400, 2)), sites=[2, 5], sigma=0.1),
    "flow": gx.Flow(40),
    "record": gx.Peak(gx.measures.contact_force),
    "adjoint": gx.Reversible(),
    "solver": gx.SRKN11b(),
    "adaptive": gx.RKN86(),
    "waveform": gx.Harmonic(LONG, 1.0),
    "taylor": gx.laws.taylor(gx.Hertz(LONG, 1.0)),
    "tuning": gx.tune(),
    "sum": gx.Hertz() + gx.Linear(0.2),
    "function": gx.Modulated(gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()), lambda t: 1 + t),
    "localisation": gx.breathers.localisation(CHAIN, gx.states.impact(CHAIN)),
}


@pytest.mark.parametrize("name", PRINTED)
def test_it_is_read(name):
    legible(repr(PRINTED[name]))


def test_numbers_have_their_units():
    assert (
        repr(STEEL) == "Material(name='steel 316', young=193 GPa, poisson=0.3, density=8000 kg/m^3)"
    )
    assert repr(PRINTED["units"]) == "Units(mass=0.001 kg, length=1e-06 m, time=1e-05 s)"
    assert "mass           0.0287" in repr(PRINTED["beads"]) and " kg" in repr(PRINTED["beads"])
    assert "kg" not in repr(CHAIN) and "shape (400), 0.5 ... 1" in repr(CHAIN)
    assert repr(gx.Hertz(2.0, 0.5)) == "Hertz(stiffness=2, precompression=0.5)"
    assert (
        repr(gx.PowerLaw(LONG, 2.0)) == "PowerLaw(stiffness=[shape (400), 0.5 ... 1], exponent=2)"
    )


def test_whole_numbers_keep_their_digits():
    assert [
        numbers(np.array(x)) for x in ([1234567, 3], 1234567, [[1234567], [3]], [0.1234567])
    ] == ["1234567, 3", "1234567", "shape (2, 1), 3 ... 1234567", "0.123457"]


def test_what_is_traced_prints_too():
    seen = []

    def inside(x):
        chain = gx.scenes.dimer(6, ratio=x)
        seen.extend(
            map(
                repr,
                (
                    chain,
                    gx.Hertz(x),
                    gx.states.impact(chain, x),
                    STEEL,
                    Units(x),
                    gx.Harmonic(x, x),
                ),
            )
        )
        return x

    jax.vmap(inside)(jnp.ones(3))
    jax.jit(inside)(1.0)
    assert seen[1] == seen[7] == "Hertz(stiffness=traced, shape ())" and "traced" in seen[0]
    for leaf in (None, object(), "word", jax.ShapeDtypeStruct((2,), float)):
        assert repr(jax.tree.map(lambda x, leaf=leaf: leaf, CHAIN)) and repr(
            jax.tree.map(lambda x, y=leaf: y, STEEL)
        )
