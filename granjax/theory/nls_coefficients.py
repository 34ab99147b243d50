"""Coefficients of the envelope equation of a periodic chain; the equation is in `nls`."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Integer

from ..base.checks import concrete, one_of, parameter, per_lane, positive, refuse, show, traced
from ..base.derivatives import with_slope
from ..base.programs import compiled
from ..base.types import Count, Parameter, Scalar
from ..results import Result, array

# the relative distance of omega^2, in units of rounding, below which two branches touch, or omega
# is zero
TOUCHING = 1e6
# the same below which the second harmonic lies on a branch
RESONANT = 1e5
# orders of derivatives: two in k, and two in the parameters
ORDERS = 4


class Coefficients(Result):
    """The result of `coefficients`, for Y as defined in `nls`; P bonds and sites per cell.

    **Example:**

    >>> found = gx.theory.nls.coefficients(1.0, 1.5, 0.375, -0.0625, np.pi)
    >>> round(float(found.omega), 6), round(float(found.nu3), 6)  # 6^{1/2}, nu3 of `B`
    (2.44949, -0.459279)
    """

    k: Float[Array, "*lanes"] = array("The wave number.", "rad", "lane")
    omega: Float[Array, "*lanes"] = array("The frequency.", "rad/s", "lane")
    group_velocity: Float[Array, "*lanes"] = array("d omega/dk, in cells per time.", "1/s", "lane")
    nu2: Float[Array, "*lanes"] = array("nu2, in cells^2 per time.", axes="lane")
    nu3: Float[Array, "*lanes"] = array(
        "nu3 under the constraint, in 1/(length^2 time).", axes="lane"
    )
    nu3_force: Float[Array, "*lanes"] = array(
        "nu3 at constant force, which holds for every modulated envelope.", axes="lane"
    )
    mode: Complex[Array, "*lanes P"] = array("The displacements per Y.", axes="lane ... site")
    strain: Complex[Array, "*lanes P"] = array("The strains s_j per Y.", axes="lane ... bond")
    strain_slope: Complex[Array, "*lanes P"] = array("ds/dk.", axes="lane ... bond")
    mean_strain: Float[Array, "*lanes P"] = array(
        "The mean strain per |Y|^2, under the constraint.", axes="lane ... bond"
    )
    mean_strain_force: Float[Array, "*lanes P"] = array(
        "The mean strain per |Y|^2, at constant force.", axes="lane ... bond"
    )
    harmonic_mode: Complex[Array, "*lanes P"] = array(
        "The second harmonic of the displacements per Y^2, on e^{2i(kn + omega t)}.",
        axes="lane ... site",
    )
    harmonic_strain: Complex[Array, "*lanes P"] = array(
        "The second harmonic of the strains per Y^2.", axes="lane ... bond"
    )
    resonant: Bool[Array, "*lanes"] = array(
        "Whether 2k, 2 omega is a wave of the chain that the second harmonic drives; `nu3` "
        "is then infinite.",
        axes="lane",
    )
    bond: Integer[Array, "*lanes"] = array(
        "The bond whose s_j is real and positive: the most strained one, the first if several "
        "are equal.",
        axes="lane",
    )

    @property
    def focusing(self) -> Bool[Array, "*lanes"]:
        """Whether nu2 nu3 > 0 for a modulated envelope: bright solitons and instability."""
        return self.nu2 * self.nu3_force > 0

    @property
    def outcome(self) -> str:
        nu2 = self.nu2
        nu3 = self.nu3_force
        if traced(self.resonant):
            return "Not known inside a transformation."
        if self.resonant.any():
            return "The second harmonic 2k, 2 omega is a wave of the chain: no envelope equation, nu3 is infinite."
        if not np.isfinite(nu3).all():
            return "The packet travels with the speed of sound, or its branch is not simple: no envelope equation."
        if nu2.ndim:
            return f"{nu2.size} envelope equations."
        return f"nu2 = {nu2:.6g}, nu3 = {nu3:.6g} at constant force: {'bright' if nu2 * nu3 > 0 else 'dark'} solitons."


def coefficients(
    mass: Parameter,
    K2: Parameter,
    K3: Parameter,
    K4: Parameter,
    k: Scalar,
    branch: Count = 0,
    constraint: str = "force",
) -> Coefficients:
    r"""Compute the coefficients of the envelope equation at one wave number of one branch.

    With the Bloch mode e (strains s = S(k) e of mean square 1), the third order, projected on e,
    gives nu3 = sum_j [3 K4_j |s_j|^4 + 2 K3_j (y0_j |s_j|^2 + Y2_j conj(s_j)^2)] / (2 omega sum_j
    m_j |e_j|^2). The second harmonic solves (D(2k) - 4 omega^2 M) U2 = -S(2k)^H K3 s^2, Y2 = S(2k)
    U2. The mean strain solves K2_j y0_j + 2 K3_j |s_j|^2 = f in every bond, with f = (d omega/dk)^2
    (sum_j m_j) (sum_j y0_j) at constant force and sum_j y0_j = 0 at fixed length. Monomer at
    k = pi: `B` at constant force, 3 K4 (K2 m)^{-1/2} at fixed length.

    **Arguments:**

    - `mass`, `K2`, `K3`, `K4`: scalars or (P,), one per site or bond of the cell; mass > 0, K2 > 0.
    - `k`: phase per cell [rad]; `branch`: 0 is the acoustic one.
    - `constraint`: what the ends hold constant, `"force"` or `"length"`.

    **Returns:** `Coefficients`, differentiable in every number; under `jit` and `vmap` a branch
    that is not simple gives NaN.

    **Raises** ValueError for masses or K2 that are not positive, shapes that do not fit, a branch
    that does not exist, omega = 0 (k = 0 of the acoustic branch: use Korteweg-de Vries), and where
    two branches touch.

    **Example:**

    >>> found = gx.theory.nls.coefficients(1.0, 1.5, 0.375, -0.0625, np.pi)
    >>> round(float(found.nu2), 6), round(float(found.nu3), 6)
    (0.306186, -0.459279)
    """
    mass, K2, K3, K4 = _cell(mass, K2, K3, K4)
    k = per_lane("k", k, ())
    sites = mass.size
    if not 0 <= branch < sites:
        refuse("branch", f"a branch below {sites}, as the cell has {sites} sites", repr(branch))
    length = one_of("constraint", constraint, ("force", "length")) == "length"
    found, touches = _coefficients(mass, K2, K3, K4, k, np.asarray(branch), np.asarray(length))
    omega = concrete(found.omega)
    touches = concrete(touches)
    if touches is not None and touches:
        remedy = "Give another k, or the smallest cell of the chain."
        refuse(
            "k", "one simple branch", f"{show(k)}, where branch {branch} touches another", remedy
        )
    if omega is not None and np.isnan(omega):
        refuse(
            "k",
            "a wave that oscillates",
            f"{show(k)}, where omega = 0",
            "Long waves: use Korteweg-de Vries.",
        )
    return found


def _cell(mass, K2, K3, K4):
    arrays = {"mass": positive("mass", mass), "K3": parameter("K3", K3), "K4": parameter("K4", K4)}
    arrays["K2"] = positive(
        "K2", K2, "A bond without linear stiffness carries no linear wave; give precompression."
    )
    sites = max(x.size for x in arrays.values())
    for name, x in arrays.items():
        if x.ndim > 1 or x.size not in (1, sites):
            refuse(name, f"a scalar or shape ({sites},), as another has", f"shape {x.shape}")
    return [jnp.broadcast_to(arrays[name], (sites,)) for name in ("mass", "K2", "K3", "K4")]


# the matrix S from the displacements of a cell to the strains of its bonds; `turn` is e^{ik}
def _strains(turn, sites):
    wrap = np.zeros((sites, sites))
    wrap[-1, 0] = 1
    return np.eye(sites) - np.eye(sites, k=1) - turn * wrap


def _square(z):
    return z.real**2 + z.imag**2


@compiled
def _coefficients(mass, K2, K3, K4, k, branch, length):
    sites = mass.size
    # turns mass-normalised displacements into displacements
    light = 1 / jnp.sqrt(mass)
    # The derivatives of `eigh` fail where any two branches touch. So its result is a constant, and
    # the corrections in `wave` carry the derivatives of this branch.
    S = jax.lax.stop_gradient(_strains(jnp.exp(1j * k), sites) * light)
    squared, vectors = jnp.linalg.eigh((S.conj().T * jax.lax.stop_gradient(K2)) @ S)
    own = squared[branch]
    rounding = jnp.finfo(squared.dtype).eps
    least = TOUCHING * rounding * squared[-1]
    gap = squared - own
    same = jnp.abs(gap) <= least
    touches = jnp.any(same & (jnp.arange(sites) != branch))
    inverse = (vectors * jnp.where(same, 0, 1 / jnp.where(same, 1, gap))) @ vectors.conj().T

    # omega^2, mass-normalised displacements, and strains, from M^{-1/2} D M^{-1/2} = S^H K2 S
    def wave(k):
        S = _strains(jnp.exp(1j * k), sites) * light
        H = (S.conj().T * K2) @ S
        v = vectors[:, branch]
        value = own
        for _ in range(ORDERS):
            v = v - inverse @ (H @ v - value * v)
            v = v * (1 / jnp.sqrt(jnp.sum(_square(v))))
            value = jnp.real(v.conj() @ H @ v)
        return value, v, S @ v

    along = lambda f: lambda k: with_slope(f, k)
    ((value, v, strain), (first, _, strain1)), (_, (second, _, _)) = along(along(wave))(k)
    omega = jnp.sqrt(jnp.where((own > least) & ~touches, value, jnp.nan))
    velocity = first / (2 * omega)
    curvature = (second / 2 - velocity**2) / omega

    size = _square(strain)
    product = strain.conj() * strain1
    bond = jnp.argmax(size > (1 - 1e-9) * size.max())
    norm = strain[bond].conj() * (1 / jnp.sqrt(size[bond] * jnp.mean(size)))
    norm1 = jnp.mean(product.real) / jnp.mean(size) + 1j * (product[bond].imag / size[bond])
    e = v * light * norm
    s = strain * norm
    s1 = strain1 * norm - norm1 * s
    size = size / jnp.mean(size)

    doubled = _strains(jnp.exp(2j * k), sites) * light
    A = (doubled.conj().T * K2) @ doubled - 4 * value * jnp.eye(sites)
    push = doubled.conj().T @ (K3 * s**2)
    inverse = jnp.linalg.pinv(jax.lax.stop_gradient(A), rtol=RESONANT * rounding, hermitian=True)
    # the inverse is constant, and each correction adds one order of derivatives
    x = -inverse @ push
    for _ in range(ORDERS):
        x = x - inverse @ (push + A @ x)
    resonant = _square(A @ x + push).max() > 1e-12 * jnp.max((K3 * light * size) ** 2)
    U2 = x * light
    Y2 = doubled @ x

    give = 2 * K3 * size / K2
    compliance = jnp.sum(1 / K2)
    inertia = velocity**2 * mass.sum()
    force = -inertia * give.sum() / (1 - inertia * compliance)
    mean_force = force / K2 - give
    mean = jnp.where(length, give.sum() / compliance / K2 - give, mean_force)

    def nu3(mean):
        third = 3 * K4 * size**2 + 2 * K3 * (mean * size + jnp.real(Y2 * s.conj() ** 2))
        return jnp.where(resonant, jnp.inf, third.sum() / (2 * omega * jnp.sum(mass * _square(e))))

    found = Coefficients(
        k,
        omega,
        velocity,
        -curvature / 2,
        nu3(mean),
        nu3(mean_force),
        e,
        s,
        s1,
        mean,
        mean_force,
        *(jnp.where(resonant, jnp.inf, second) for second in (U2, Y2)),
        resonant,
        bond,
    )
    return found, touches


def B(K2: Parameter, K3: Parameter, K4: Parameter, mass: Parameter = 1.0) -> Float[Array, "..."]:
    r"""Return nu3 of the monomer chain at k = pi and constant force.

    It is (3 K2 K4 - 4 K3^2)/(K2^{3/2} m^{1/2}). For the power law A [d0 + sign(p) y]^p with m = 1
    it is -p^3 (p - 1) A^2 d0^{2p-4}/(2 K2^{3/2}), positive only for 0 < p < 1.

    **Raises** ValueError for K2 or masses that are not positive.

    **Example:**

    >>> round(float(gx.theory.nls.B(1.5, 0.375, -0.0625)), 6)  # Hertz with d0 = A = 1: dark breathers
    -0.459279
    """
    K2 = positive("K2", K2)
    mass = positive("mass", mass)
    K3 = parameter("K3", K3)
    K4 = parameter("K4", K4)
    return (3 * K2 * K4 - 4 * K3**2) / (K2 * jnp.sqrt(K2 * mass))
