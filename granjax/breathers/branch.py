"""A family of breathers, and one of them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..floquet import floquet
from ..flow import simulate
from ..lattice import State


class Breather(eqx.Module):
    """A time-periodic orbit, at rest at t = 0 (and, half a period later, again).

    **Fields:** `state`: (u, v = 0). `omega`: 2 pi/T. `energy`: from equilibrium. `residual`: max |v(T/2)|. `lattice`.
    `outcome`: what became of Newton's method. `code`: 0 where it converged, 4 where it found the equilibrium alone.
    """

    state: State
    omega: jax.Array
    energy: jax.Array
    residual: jax.Array
    lattice: object
    code: jax.Array
    outcome: str = eqx.field(static=True, default="")

    @property
    def period(self):
        """T = 2 pi/omega."""
        return 2 * np.pi / self.omega

    @property
    def converged(self):
        """Whether Newton's method did."""
        return self.code == 0

    def floquet(self, **options):
        """Its stability, a `Floquet`; `options` as in `gx.floquet.floquet`."""
        return floquet(self.lattice, self.state, float(self.period), **options)

    def run(self, frames=65, periods=1):
        """The orbit in time, a `Run` of `periods` periods."""
        return simulate(self.lattice, self.state, float(self.period) * periods, save_at=frames)


class Branch(eqx.Module):
    r"""A family of breathers, P of them, in the order in which they were found.

    **Fields:** `omega` (P,), `energy` (P,), `amplitude` (P,) (max |u| at the turning point), `u` (P, N) at the turning
    point (a dict of such for named fields). `multipliers` (P, 2n), the largest modulus first, and `error` of each;
    `verdict`: P words "stable", "unstable", "undecided". `step_error` (P,): change of the tangent map when the steps
    are doubled. `folds`: frequencies where the branch turns back. `branch_points`: where another one crosses.
    `outcome`: why it ended. `unknowns`, `tangents`: what continuation holds.
    """

    omega: np.ndarray
    energy: np.ndarray
    amplitude: np.ndarray
    u: object
    multipliers: np.ndarray
    error: np.ndarray
    verdict: np.ndarray
    step_error: np.ndarray
    folds: np.ndarray
    branch_points: np.ndarray
    outcome: str
    unknowns: np.ndarray
    tangents: np.ndarray
    curve: object
    problem: object
    lattice: object

    def __len__(self):
        return len(self.omega)

    def breather(self, i):
        """The i-th breather; -1 is the last."""
        if not -len(self) <= i < len(self):
            refuse("i", f"an index of {len(self)} breathers", repr(i))
        u = jax.tree.map(lambda x: jnp.asarray(x[i]), self.u)
        state = State(u, jax.tree.map(jnp.zeros_like, u))
        residual = self.problem.residual(jnp.asarray(self.unknowns[i]), self.omega[i], self.lattice)
        return Breather(state, float(self.omega[i]), float(self.energy[i]), float(jnp.abs(residual).max()),
                        self.lattice, 0, self.outcome)

    def to_xarray(self):
        """An `xarray.Dataset` over `point`, with `site` and `multiplier`."""
        import xarray

        fields = self.u if isinstance(self.u, dict) else {"u": self.u}
        sites = {name: (("point", *(f"{name}_{i}" for i in range(u.ndim - 1))), np.asarray(u))
                 for name, u in fields.items()}
        return xarray.Dataset({
            "omega": ("point", self.omega), "energy": ("point", self.energy), "amplitude": ("point", self.amplitude),
            "multiplier_real": (("point", "multiplier"), self.multipliers.real),
            "multiplier_imag": (("point", "multiplier"), self.multipliers.imag),
            "error": (("point", "multiplier"), self.error), "verdict": ("point", self.verdict),
            **({f"u_{name}": value for name, value in sites.items()} if isinstance(self.u, dict) else sites),
        }, attrs={"outcome": self.outcome, "folds": list(self.folds)})
