"""Dynamic mode decomposition: frequencies and decay rates of a lattice from snapshots, without a model."""

from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Complex, Float, Inexact

from ..checks import one_of, positive, refuse, unmasked, whole
from ..flow import Run
from ..results import Held, Result
from ..types import AnyArray, Count, Parameter, Scalar


class DynamicModes(Result):
    """What `dmd` returns: y(t) = sum_k b_k phi_k exp(omega_k t), by falling |b_k| |phi_k|.

    - `omega` (r,): log(lambda)/dt, complex [1/s]: the real part is the growth (negative: decay), the imaginary one the
      angular frequency, known up to the Nyquist frequency pi/dt. `eigenvalues` (r,): lambda, of one step.
    - `modes` (n, r): phi_k, of unit length. `amplitudes` (r,): b_k, at the first snapshot.
    - `singular_values`: all of them, of the snapshots (with delays, of their Hankel matrix); `rank`: r.
    - `residual`: |X' - A X|/|X'| of one step, in the Frobenius norm. `misfit`: the same of the reconstruction of the
      snapshots. `outcome`: a sentence.

    **Example:**

    >>> ts = 0.1 * np.arange(100)
    >>> found = gx.identify.dmd(np.cos(2.0 * ts)[:, None], 0.1, rank=2, delays=20)
    >>> round(float(found.reconstruction(10.0)[0]), 6)  # cos 20
    0.408082
    """

    held: ClassVar[dict[str, Held]] = {
        "omega": Held("mode", "1/s"),
        "eigenvalues": Held("mode", "1"),
        "modes": Held("sensor mode", "", "shapes"),
        "amplitudes": Held("mode"),
        "singular_values": Held("singular"),
        "real": Held(None),
    }
    omega: Complex[np.ndarray, " r"]
    eigenvalues: Inexact[np.ndarray, " r"]
    modes: Inexact[np.ndarray, "n r"]
    amplitudes: Inexact[np.ndarray, " r"]
    singular_values: Float[np.ndarray, " _"]
    residual: float
    misfit: float
    rank: int = eqx.field(static=True)
    real: bool = eqx.field(static=True)
    outcome: str = eqx.field(static=True)

    def reconstruction(self, t: Parameter) -> Inexact[np.ndarray, "*T n"]:
        """y at times t (T,) after the first snapshot: (T, n); real where the snapshots were."""
        y = np.exp(np.multiply.outer(np.asarray(t), self.omega)) * self.amplitudes @ self.modes.T
        return y.real if self.real else y


def dmd(
    snapshots: Inexact[AnyArray, "T n"],
    dt: Scalar,
    rank: Count | str | None = None,
    *,
    delays: Count = 1,
) -> DynamicModes:
    r"""Exact dynamic mode decomposition of evenly spaced snapshots.

    The linear map A of least squares from every snapshot to the next, A = X' X^+, on the r leading singular vectors
    of X = U S V^*: A_r = U^* X' V S^-1 = W Lambda W^-1, modes Phi = X' V S^-1 W. With delays d > 1 each snapshot is
    stacked with the d - 1 that follow it (Hankel DMD), so that few sensors see many modes: 2M real frequencies need
    n d >= 2M, as do displacements and velocities of M sites without delays.

    **Arguments:**

    - `snapshots`: (T, n), times first, such as `snapshots(run)` gives; real or complex. `dt`: their spacing [s].
    - `rank`: r; `None` keeps the singular values above rounding, sigma > max(n d, T) eps sigma_1: right for clean
      data, since noise would be kept too; `"optimal"` keeps those above the hard threshold of Gavish and Donoho for
      noise of unknown size, omega(beta) times their median: right where most of them are noise.
    - `delays`: d >= 1. The window d dt must be about as long as the inverse of the least spacing of the frequencies,
      or modes are lost among rounding; with noise half of the record is usual.

    **Returns:** `DynamicModes`. Noise in the snapshots biases eigenvalues inwards (a spurious decay), which delays and
    a low rank lessen.
    **Raises** ValueError for snapshots that are not finite or not a (T, n) array, fewer than two after stacking, a
    rank above theirs, dt <= 0, delays < 1.
    Source: Tu, Rowley, Luchtenburg, Brunton, Kutz, J. Comput. Dyn. 1, 391 (2014); Arbabi, Mezic, SIAM J. Appl. Dyn.
    Syst. 16, 2096 (2017); Gavish, Donoho, IEEE Trans. Inf. Theory 60, 5040 (2014).

    **Example:**

    >>> ts = 0.1 * np.arange(100)
    >>> signal = np.exp(-0.1 * ts) * np.cos(2.0 * ts)
    >>> found = gx.identify.dmd(signal[:, None], 0.1, rank=2, delays=20)
    >>> found.omega.real.round(6).tolist(), np.abs(found.omega.imag).round(6).tolist()
    ([-0.1, -0.1], [2.0, 2.0])
    """
    y, dt, delays = _checked(snapshots), float(positive("dt", dt)), whole("delays", delays, 1)
    T, n = y.shape
    if T - delays < 1:
        refuse("delays", f"fewer than the {T} snapshots", f"{delays}")
    X = np.concatenate([y[i : T - delays + 1 + i].T for i in range(delays)])
    now, after = X[:, :-1], X[:, 1:]
    U, s, Vh = np.linalg.svd(now, full_matrices=False)
    r = _rank(rank, s, now.shape)
    U, V = U[:, :r], Vh[:r].conj().T
    step = after @ (V / s[:r])
    reduced = U.conj().T @ step
    eigenvalues, W = np.linalg.eig(reduced)
    modes = step @ W
    modes = modes / np.linalg.norm(modes, axis=0)
    amplitudes = np.linalg.lstsq(modes, X[:, 0], rcond=None)[0]
    # the first of the stacked snapshots is the present
    modes, size = modes[:n], np.linalg.norm(modes[:n], axis=0)
    size = np.where(size > 0, size, 1)
    modes, amplitudes = modes / size, amplitudes * size
    order = np.argsort(-np.abs(amplitudes), kind="stable")
    eigenvalues, modes, amplitudes = eigenvalues[order], modes[:, order], amplitudes[order]
    with np.errstate(divide="ignore"):
        omega = np.log(eigenvalues.astype(complex)) / dt
    residual = np.linalg.norm(after - step @ (U.conj().T @ now)) / np.linalg.norm(after)
    powers = np.vander(eigenvalues, T, increasing=True)
    misfit = np.linalg.norm((modes * amplitudes) @ powers - y.T) / np.linalg.norm(y)
    outcome = (
        f"{r} of {len(s)} singular values kept; one step is met to {residual:.2g}, the snapshots to {misfit:.2g} "
        "of their norm."
    )
    return DynamicModes(
        omega,
        eigenvalues,
        modes,
        amplitudes,
        s,
        float(residual),
        float(misfit),
        r,
        not np.iscomplexobj(y),
        outcome,
    )


def snapshots(run: Run, velocities: bool = True) -> Float[np.ndarray, "T n"]:
    """Displacements and, behind them, velocities of a run's frames as one array (T, n), fields one after the other.

    **Arguments:** `run`: a `Run` with even times; `velocities=False` leaves the displacements alone.
    **Returns:** a NumPy array, n = 2N for a chain of N.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=51)
    >>> gx.identify.snapshots(run).shape
    (51, 40)
    """
    leaves = jax.tree.leaves((run.us, run.vs) if velocities else run.us)
    return np.concatenate([np.asarray(x).reshape(len(run.ts), -1) for x in leaves], axis=1)


def _checked(snapshots):
    y = np.asarray(unmasked("snapshots", snapshots))
    y = y if y.dtype.kind == "c" else y.astype(float)
    if y.ndim != 2 or len(y) < 2 or not y.any() or not np.isfinite(y).all():
        refuse(
            "snapshots",
            "finite numbers (T, n), not all zero, of two times or more",
            f"shape {y.shape}",
            "Times come first.",
        )
    return y


def _rank(rank, s, shape):
    if rank is None:
        r = int(np.count_nonzero(s > max(shape) * np.finfo(s.dtype).eps * s[0]))
    elif isinstance(rank, str):
        one_of("rank", rank, ("optimal",))
        r = int(np.count_nonzero(s > hard_threshold(shape) * np.median(s)))
    else:
        r = whole("rank", rank, 1)
    if not 1 <= r <= np.count_nonzero(s):
        refuse(
            "rank",
            f"1 to {np.count_nonzero(s)}, the rank of the snapshots",
            f"{r}",
            "Give a number.",
        )
    return r


def hard_threshold(shape: tuple[Scalar, Scalar]) -> float:
    r"""Optimal hard threshold over the median singular value, of a matrix of some shape with unknown white noise.

    lambda(beta)/sqrt(median of the Marchenko-Pastur law), beta = rows over columns (or inverse) in (0, 1],
    lambda^2 = 2 (beta + 1) + 8 beta/(beta + 1 + sqrt(beta^2 + 14 beta + 1)). **Arguments:** `shape`: (rows, columns).
    **Returns:** a float; 2.8584 for a square. Source: Gavish, Donoho, IEEE Trans. Inf. Theory 60, 5040 (2014).

    **Example:**

    >>> round(gx.identify.hard_threshold((50, 50)), 3)
    2.858
    """
    beta = min(shape) / max(shape)
    square = 2 * (beta + 1) + 8 * beta / (beta + 1 + np.sqrt(beta**2 + 14 * beta + 1))
    # x = 1 + beta - 2 sqrt(beta) cos(angle) takes the roots out of the density's ends
    angle = (np.arange(20000) + 0.5) * np.pi / 20000
    x = 1 + beta - 2 * np.sqrt(beta) * np.cos(angle)
    cell = np.sin(angle) ** 2 / x
    return float(np.sqrt(square / np.interp(cell.sum() / 2, np.cumsum(cell) - cell / 2, x)))
