"""Materials and contacts of elastic bodies: from moduli and radii to F = A d^{3/2}.

The table holds published constants. Real alloys differ by some per cent, polymers by a factor of
two with rate and temperature.
"""

import difflib
import math
import warnings
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .base.checks import broadcast, concrete, positive, real, refuse, traced, within
from .base.printing import called
from .base.types import Number, Parameter

__all__ = [
    "NAMES",
    "Material",
    "bead_mass",
    "hertz_coefficient",
    "material",
    "stack",
    "yield_overlap",
]

# m; a larger bead radius was probably meant in millimetres
LARGEST = 0.5
_BOECHLER = "as used by Boechler et al., Phys. Rev. Lett. 104, 244302 (2010)"
_CALLISTER = "Callister, Materials Science and Engineering, appendix B"

# E [Pa], nu, rho [kg/m^3], source
_TABLE = {
    "steel 316": (193e9, 0.30, 8000.0, f"{_BOECHLER}; density: {_CALLISTER}"),
    "steel 440C": (200e9, 0.28, 7650.0, "manufacturers' data sheets of AISI 440C, hardened"),
    "chrome steel": (
        203e9,
        0.30,
        7780.0,
        "AISI 52100, as used by Job et al., Phys. Rev. Lett. 94, 178002 (2005)",
    ),
    "aluminium 6061-T6": (73.5e9, 0.33, 2690.0, f"{_BOECHLER}; density from the beads' mass there"),
    "brass": (97e9, 0.34, 8500.0, f"free-cutting brass C36000, {_CALLISTER}"),
    "bronze": (
        76e9,
        0.414,
        8500.0,
        "as used by Porter et al., Phys. Rev. E 77, 015601 (2008); density from mass",
    ),
    "PTFE": (1.46e9, 0.46, 2200.0, "as used by Daraio et al., Phys. Rev. E 72, 016603 (2005)"),
    "tungsten carbide": (630e9, 0.22, 14900.0, "with 6 % cobalt, manufacturers' data sheets"),
    "Delrin": (3.1e9, 0.35, 1420.0, "acetal homopolymer Delrin 500, manufacturer's data sheet"),
    "nylon": (
        2.7e9,
        0.39,
        1140.0,
        f"nylon 6,6, dry, middle of the range 1.6 to 3.8 GPa, {_CALLISTER}",
    ),
}
_ALIASES = {
    "aluminium": "aluminium 6061-T6",
    "aluminum": "aluminium 6061-T6",
    "aluminum 6061-T6": "aluminium 6061-T6",
    "stainless steel 316": "steel 316",
    "stainless steel 440C": "steel 440C",
    "steel 52100": "chrome steel",
    "Teflon": "PTFE",
    "acetal": "Delrin",
    "POM": "Delrin",
    "nylon 6,6": "nylon",
}

NAMES = (*_TABLE, "rigid")


class Material(eqx.Module):
    """An elastic material.

    **Arguments:** `name`; `young`: Young's modulus E > 0 [Pa]; `poisson`: Poisson's ratio in (-1,
    0.5]; `density` > 0 [kg/m^3]; `source` of the numbers, a text. The numbers may be arrays, one
    per bead, or traced: `jax.grad` by E works.

    **Raises** ValueError for numbers that are not finite or outside these ranges.

    **Example:**

    >>> bone = gx.materials.Material("bone", young=10e9, poisson=0.3, density=1900.0)
    >>> round(float(gx.materials.hertz_coefficient(bone, 9.53e-3)) / 1e8, 4)
    5.0571
    """

    name: str = eqx.field(static=True)
    young: jax.Array
    poisson: jax.Array
    density: jax.Array
    source: str = eqx.field(static=True)

    def __init__(
        self, name: str, young: Parameter, poisson: Parameter, density: Parameter, source: str = ""
    ):
        self.name = str(name)
        self.source = str(source)
        self.young = positive(
            "young", young, "Young's modulus is in pascal: 193e9 for steel, 1.46e9 for PTFE."
        )
        self.poisson = within(
            "poisson", poisson, -1, 0.5, open_low=True, remedy="Poisson's ratio is 0.3 for steel."
        )
        self.density = positive(
            "density", density, "The density is in kg/m^3: 8000 for steel, 2200 for PTFE."
        )

    def __repr__(self) -> str:
        giga = self.young / 1e9 if eqx.is_array_like(self.young) else self.young
        values = {
            "name": self.name,
            "young": giga,
            "poisson": self.poisson,
            "density": self.density,
        }
        return called("Material", values, {"young": "GPa", "density": "kg/m^3"})

    @property
    def compliance(self) -> Number:
        """(1 - nu^2)/E [1/Pa], the body's part of 1/E*."""
        return (1 - self.poisson**2) / self.young


def _plain(name):
    return "".join(c for c in name.lower() if c not in " -_,./")


_PLAIN = {_plain(name): _ALIASES.get(name, name) for name in (*NAMES, *_ALIASES)}


def material(name: str | Material) -> Material:
    """Return a material of the table by its name.

    Capitals, spaces, dashes and underscores do not matter. Names: `granjax.materials.NAMES`.
    `"rigid"` is a body that does not deform (E infinite), for walls. A `Material` passes through.
    **Raises** ValueError for another name, suggesting the nearest.

    **Example:**

    >>> gx.materials.material("Steel_316").name
    'steel 316'
    """
    return named("name", name)


def named(argument: str, name: str | Material) -> Material:
    """Return `material(name)`; errors name the given argument."""
    if isinstance(name, Material):
        return name
    known = _PLAIN.get(_plain(name))
    if known is None:
        close = difflib.get_close_matches(_plain(name), _PLAIN, n=3, cutoff=0.5)
        near = " or ".join(repr(x) for x in dict.fromkeys(_PLAIN[x] for x in close))
        remedy = f"Did you mean {near}?" if near else "Or give Material(name, E, nu, rho)."
        refuse(argument, "one of " + ", ".join(map(repr, NAMES)), repr(name), remedy)
    if known == "rigid":
        unit = Material("rigid", 1.0, 0.0, 1.0, "a body that does not yield and does not move")
        infinite = jnp.full((), jnp.inf)
        return eqx.tree_at(lambda m: (m.young, m.density), unit, (infinite, infinite))
    return Material(known, *_TABLE[known])


def stack(materials: Sequence[str | Material]) -> Material:
    """Return one `Material` with arrays (N,), from N materials or names."""
    bodies = [named(f"materials[{i}]", m) for i, m in enumerate(materials)]
    young, poisson, density = (
        jnp.stack([getattr(b, n) for b in bodies]) for n in ("young", "poisson", "density")
    )
    placed = Material(
        "mixed", jnp.ones(len(bodies)), 0.0, 1.0, "; ".join(dict.fromkeys(b.source for b in bodies))
    )
    return eqx.tree_at(lambda m: (m.young, m.poisson, m.density), placed, (young, poisson, density))


def _radius(argument, radius):
    return positive(argument, radius, "A radius is in metres, above zero.")


def _radius_or_plane(argument, radius):
    value = None if traced(radius) else real(argument, radius)
    if value is None or not np.isposinf(value).any():
        remedy = "A radius is in metres, above zero, or infinite for a plane."
        return positive(argument, radius, remedy)
    _radius(argument, np.where(np.isposinf(value), 1.0, value))
    return radius if isinstance(radius, jax.Array) else jnp.asarray(value)


def _not_both(argument, one, x, remedy):
    value = concrete(x)
    if value is not None and not np.all(value > 0):
        refuse(argument, f"at most one {one}", "two", remedy)


def _effective_modulus(first, second):
    compliance = first.compliance + second.compliance
    _not_both("material_2", "rigid body", compliance, "Two rigid bodies have no contact law.")
    return 1 / compliance


def hertz_coefficient(
    material_1: str | Material,
    radius_1: Parameter,
    material_2: str | Material | None = None,
    radius_2: Parameter | None = None,
) -> Number:
    r"""Return the coefficient A of the contact F = A d^{3/2} of two elastic spheres.

    A = (4/3) E* sqrt(R*),   1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2,   1/R* = 1/R1 + 1/R2;

    for equal beads A = E sqrt(2R)/(3 (1 - nu^2)).

    **Arguments:** `material_1`, `material_2`: a `Material` or a name of the table; `radius_1`,
    `radius_2` > 0 [m], arrays that broadcast, `jnp.inf` for a plane. By default the second body
    equals the first.

    **Returns:** A [N/m^{3/2}], for `Hertz(stiffness=A)`. Typical: steel beads of 9.53 mm radius
    9.8e9, PTFE of 2.38 mm 4.3e7.
    **Raises** ValueError for a radius <= 0, two planes, or two rigid bodies.
    Source: K. L. Johnson, Contact Mechanics (1985), section 4.2; valid for contacts small against
    the radii.

    **Example:**

    >>> round(float(gx.materials.hertz_coefficient("steel 316", 9.53e-3)) / 1e9, 4)
    9.7601
    >>> round(float(gx.materials.hertz_coefficient("steel 316", 9.53e-3, "rigid", jnp.inf)) / 1e9, 4)
    27.6058
    """
    first = named("material_1", material_1)
    second = first if material_2 is None else named("material_2", material_2)
    R1 = _radius_or_plane("radius_1", radius_1)
    R2 = R1 if radius_2 is None else _radius_or_plane("radius_2", radius_2)
    broadcast(radius_1=R1, radius_2=R2, material_1=first.compliance, material_2=second.compliance)
    curvature = 1 / R1 + 1 / R2
    _not_both("radius_1 and radius_2", "plane", curvature, "Two planes have no Hertz contact.")
    return 4 / 3 * _effective_modulus(first, second) / jnp.sqrt(curvature)


def yield_overlap(
    pressure: Parameter,
    material_1: str | Material,
    radius_1: Parameter,
    material_2: str | Material | None = None,
    radius_2: Parameter | None = None,
) -> Number:
    r"""Return the overlap at which a contact yields, s_y = (pi p_y/(2 E*))^2 R* [m].

    There the pressure at the centre of the contact reaches p_y.

    **Arguments:** `pressure`: p_y > 0 [Pa], 1.6 times the yield stress where yielding begins, up to
    3 times for fully plastic contacts; materials and radii as in `hertz_coefficient`.
    **Returns:** s_y, for `gx.Thornton(stiffness, s_y)`. Typical: 3e-6 m for steel beads of 1 cm
    radius and 1.6e9 Pa.
    **Raises** ValueError as `hertz_coefficient` does.
    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).
    """
    first = named("material_1", material_1)
    second = first if material_2 is None else named("material_2", material_2)
    modulus = _effective_modulus(first, second)
    # sqrt(R*), from the contact's coefficient (4/3) E* sqrt(R*)
    root = 0.75 * hertz_coefficient(first, radius_1, second, radius_2) / modulus
    return (jnp.pi * positive("pressure", pressure) / (2 * modulus) * root) ** 2


def bead_mass(material: str | Material, radius: Parameter) -> Number:
    """Return the mass of a solid sphere, m = (4/3) pi R^3 rho [kg].

    **Arguments:** a `Material` or a name of the table; `radius` R > 0 [m], a number or an array.
    **Warns** for a diameter above a metre. **Raises** ValueError for a radius <= 0, or a rigid
    body, which has no density.

    **Example:**

    >>> round(float(gx.materials.bead_mass("steel 316", 9.53e-3)), 6)
    0.029004
    """
    body = named("material", material)
    density = concrete(body.density)
    if density is not None and not np.all(np.isfinite(density)):
        refuse(
            "material",
            "a material with a density",
            "'rigid'",
            "A rigid body stands for a wall, not for a bead.",
        )
    R = _radius("radius", radius)
    broadcast(radius=R, density=body.density)
    known = concrete(R)
    if known is not None and np.any(known > LARGEST):
        warnings.warn(
            f"A bead has a radius of {known.max():g} m, more than a metre across. Radii are in metres: "
            "9.5 mm is 9.5e-3.",
            stacklevel=2,
        )
    return 4 / 3 * math.pi * R**3 * body.density
