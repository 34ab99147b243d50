"""Figures breather.1 to breather.3: dark breathers, conservative and driven, and the bright breather of a dimer."""

import math
from types import SimpleNamespace

import numpy as np
import xarray as xr

from ...breathers import breather
from ...checks import refuse, whole
from ...forced import forced_orbit
from ...laws import taylor
from ...linear import bands
from ...scenes import monomer, pattern
from ...theory import nls
from ...types import Count, Scalar
from ..dark_breather import dark_by_interference, steel_chain
from .figure import Choice, Figure

# 1 - omega_b/omega_0 of the comparison with the envelope
DETUNINGS = (0.01, 0.015, 0.02, 0.03, 0.04)


def dark(beads: Count, frequency: Scalar) -> xr.Dataset:
    """Dark breathers of a monomer, A = d0 = m = 1, constant force at both ends, and their envelope's.

    Strain at the turning point, its part that is odd in harmonics, [y(0) - y(T/2)]/2, and at one quarter of the chain
    that part's size over several frequencies, all against the black soliton 2 (kappa/B)^{1/2} tanh of the NLS equation.
    """
    beads = whole("beads", beads, 40, "The dip needs a background on either side.")
    if beads % 2:
        refuse("beads", "an even number, so that a bond is in the middle", repr(beads))
    lattice = monomer(beads, precompression=1.0, boundary="free")
    edge = float(bands(lattice).upper[0])
    coefficients = nls.coefficients(1.0, *taylor(lattice.terms[0].law), math.pi)
    found, odd, size, envelope = [], [], [], []
    for ratio in (frequency, *(1 - d for d in DETUNINGS)):
        found.append(breather(lattice, ratio * edge, "dark"))
        u = np.asarray(found[-1].run(2).us)
        y = u[:, :-1] - u[:, 1:]
        odd.append((y[0] - y[1]) / 2)
        size.append(abs(odd[-1][beads // 4]))
        envelope.append(2 * float(nls.dark_profile(coefficients, ratio * edge, beads).amplitude))
    profile = nls.dark_profile(coefficients, frequency * edge, beads)
    u = np.asarray(found[0].state.u)
    return xr.Dataset(
        {
            "strain": ("contact", u[:-1] - u[1:]),
            "odd": ("contact", odd[0]),
            "envelope_strain": ("contact", np.asarray(profile.strain)[:-1]),
            "amplitude": ("detuning", size[1:]),
            "envelope_amplitude": ("detuning", envelope[1:]),
        },
        {"contact": np.arange(beads - 1) + 0.5, "detuning": list(DETUNINGS)},
        {
            "energy": float(found[0].energy), "amplitude_at_quarter": size[0], "envelope_at_quarter": envelope[0],
            "frequency": float(found[0].omega), "units": "scaled: A = d0 = m = 1",
        },
    )


def envelope_error(data: xr.Dataset) -> np.ndarray:
    """Relative error of the envelope's amplitude at every detuning, (D,)."""
    return data["envelope_amplitude"].values / data["amplitude"].values - 1


def order(data: xr.Dataset) -> float:
    """Slope of that error over the detuning, both logarithmic."""
    return float(np.polyfit(np.log(data["detuning"].values), np.log(envelope_error(data)), 1)[0])


def _draw_dark(plots, figure, data):
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    contact, blue, red = data["contact"].values, plots.COLOURS[0], plots.COLOURS[1]
    left.plot(contact, data["envelope_strain"].values, "-", color=red, lw=1.0, label="NLS")
    left.plot(contact, data["strain"].values, "o", color=blue, ms=3.5, mec="white", mew=0.3, label="Newton")
    left.set_xlabel("contact")
    left.set_ylabel("strain $y_n$ (compression positive)")
    left.set_title(rf"$\omega_b = {data.attrs['frequency']:.4f}$")
    left.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.12))
    detuning, error = 100 * data["detuning"].values, 100 * envelope_error(data)
    right.loglog(detuning, error, "o-", color=blue, label=f"slope {order(data):.2f}")
    right.loglog(detuning, error[0] * detuning / detuning[0], "--", color="0.55", label="slope 1")
    for axis, ticks in ((right.xaxis, (1, 2, 3, 4)), (right.yaxis, (3, 5, 10))):
        axis.set_ticks(ticks, [str(tick) for tick in ticks])
        axis.set_ticks([], minor=True)
    right.set_xlabel(r"$1 - \omega_b/\omega_0$ (%)")
    right.set_ylabel("error of the NLS amplitude (%)")
    right.legend()


def driven(amplitude: Scalar, frequency: Scalar) -> xr.Dataset:
    """Dark breather of 21 driven, damped steel beads from rest, and Newton's orbit; one period of the velocities.

    `cutoff` is that of the infinite chain, `highest_mode` that of the 21 beads between walls [Hz].
    """
    settled = dark_by_interference(amplitude=amplitude, frequency=frequency)
    attractor = settled.attractor
    if attractor.multiple != 1:
        raise RuntimeError(f"The chain does not settle to one period. {attractor.outcome}")
    frames = len(attractor.ts)
    orbit = forced_orbit(settled.lattice, attractor.period).run(frames)
    return xr.Dataset(
        {
            "velocity": (("time", "bead"), np.asarray(attractor.vs), {"units": "m/s"}),
            "orbit_velocity": (("time", "bead"), np.asarray(orbit.vs), {"units": "m/s"}),
            "change": ("period", attractor.changes),
        },
        {"time": ("time", np.asarray(attractor.ts), {"units": "s"}), "bead": np.arange(1, 1 + orbit.vs.shape[1]),
         "period": np.arange(1, 1 + len(attractor.changes))},
        {"frequency": settled.frequency, "cutoff": float(bands(steel_chain()).upper[0]) / (2 * math.pi),
         "highest_mode": settled.highest_mode, "depth": settled.depth, "width": settled.width,
         "background": settled.background, "outcome": settled.outcome},
    )


def swing(data: xr.Dataset) -> float:
    """Root mean square of the velocities of all beads over a period, after settling from rest [mm/s]."""
    return 1e3 * float(np.sqrt((data["velocity"].values ** 2).mean()))


def disagreement(data: xr.Dataset) -> float:
    """Largest difference of the velocities of the chain from rest and of Newton's orbit, over the largest velocity."""
    v, exact = data["velocity"].values, data["orbit_velocity"].values
    return float(np.abs(v - exact).max() / np.abs(exact).max())


def _draw_driven(plots, figure, data):
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    bead, v, orbit = data["bead"].values, 1e3 * data["velocity"].values, 1e3 * data["orbit_velocity"].values
    for i, row in enumerate(v[::2]):
        left.plot(bead, row, "-", color=plots.COLOURS[2], lw=0.7, alpha=0.6, label="" if i else "velocity in time")
    for i, end in enumerate((np.max, np.min)):
        left.plot(bead, end(v, 0), "o", ms=7, mfc="none", mec=plots.COLOURS[0], label="" if i else "maxima, minima")
        left.plot(bead, end(orbit, 0), ".", ms=5, color=plots.COLOURS[1], label="" if i else "Newton's orbit")
    left.set_xlabel("bead")
    left.set_ylabel("velocity (mm/s)")
    left.set_xticks(bead[::5])
    left.set_title("driven at {frequency:.0f} Hz; highest mode {highest_mode:.0f} Hz, cut-off {cutoff:.0f} Hz".format(
        **data.attrs))
    left.set_ylim(top=1.35 * v.max())
    left.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.3)
    right.semilogy(data["period"].values, data["change"].values, color=plots.COLOURS[0])
    right.set_xlabel("period since rest")
    right.set_ylabel("change per period (relative)")


def bright(beads: Count, heavy: Scalar, frequency: Scalar) -> xr.Dataset:
    """The bright breather of a dimer, light beads of mass 1, A = d0 = 1, constant force, and its leading multiplier."""
    beads = whole("beads", beads, 21, "The breather needs room on either side.")
    if beads % 4 != 1:
        refuse("beads", "a multiple of 4, plus 1, so that a light bead is in the middle", repr(beads))
    lattice = pattern(beads, (1.0, heavy), precompression=1.0, boundary="free")
    found = breather(lattice, frequency * float(bands(lattice).lower[1]))
    fl = found.floquet()
    return xr.Dataset(
        {
            "displacement": ("site", np.asarray(found.state.u)),
            "multiplier_real": ("multiplier", fl.multipliers.real), "error": ("multiplier", fl.error),
            "multiplier_imag": ("multiplier", fl.multipliers.imag), "krein": ("multiplier", fl.krein),
            "mode_real": ("part", fl.vectors[:, 0].real), "mode_imag": ("part", fl.vectors[:, 0].imag),
        },
        {"site": np.arange(beads)},
        {"energy": float(found.energy), "omega": float(found.omega), "expected_at_one": fl.expected,
         "verdict": fl.verdict, "outcome": fl.outcome, "units": "scaled: A = d0 = light mass = 1"},
    )


def largest_multiplier(data: xr.Dataset) -> float:
    """Modulus of the leading multiplier."""
    return float(np.hypot(data["multiplier_real"].values[0], data["multiplier_imag"].values[0]))


def _draw_bright(plots, figure, data):
    fl = SimpleNamespace(
        multipliers=data["multiplier_real"].values + 1j * data["multiplier_imag"].values, krein=data["krein"].values,
        error=data["error"].values, expected=int(data.attrs["expected_at_one"]), rate=0.0,
        period=2 * np.pi / data.attrs["omega"],
        vectors=(data["mode_real"].values + 1j * data["mode_imag"].values)[:, None],
    )
    orbit = SimpleNamespace(state=(data["displacement"].values, None))
    axes = plots.breather(orbit, fl, figure.subplots(2, 2), mode=0 if data.attrs["verdict"] == "unstable" else None)
    axes[0, 0].set_title(rf"$\omega_b = {data.attrs['omega']:.5f}$, $E = {data.attrs['energy']:.6f}$")


FIGURES = (
    Figure(
        label="breather.1",
        title="Dark breather of the granular chain and its NLS approximation",
        caption="Strain of the bond-centred dark breather of a monomer chain at its turning point, by Newton's method "
        "(dots) and from the defocusing NLS equation (line), A = d0 = m = 1. Constant force at the ends: the strain "
        "vanishes there too. Right: error of the NLS amplitude at a quarter of the chain.",
        compute=dark,
        draw=_draw_dark,
        number=order,
        quantity="order in 1 - omega_b/omega_0 of the error of the NLS amplitude",
        expected=1.0,
        tolerance=0.1,
        source="the envelope's next order, epsilon^2 = 1 - omega_b/omega_0",
        chosen={
            "beads": Choice(82, "", "beads of the chain, an even number"),
            "frequency": Choice(0.99, "omega_0", "of the profile shown"),
        },
        binding=("beads",),
    ),
    Figure(
        label="breather.2",
        title="Dark breather of a driven, damped steel chain, from rest and by Newton's method",
        caption="Simulation of the experiment: 21 beads of steel (E = 200 GPa, nu = 0.3, 28.2 g, radius 9.53 mm, 10 N, "
        "damping time 5 ms) between walls that push towards the chain at the same time. Velocities "
        "after settling from rest, their extrema, and those of the periodic orbit by Newton's method. Cut-off: of the "
        "infinite chain; highest mode: of the 21 beads between walls. Right: change of the state from one period to "
        "the next. Where it first falls to 1e-8 all velocities are disturbed at random, by up to 1e-6 of the largest, "
        "once: what settles must be stable against motions without the mirror symmetry of the start, and these decay "
        "more slowly.",
        compute=driven,
        draw=_draw_driven,
        number=swing,
        quantity="root mean square of all velocities, settled from rest [mm/s]",
        expected=6.69536459,
        tolerance=1e-6,
        source="harmonic balance in NumPy (benchmarks/references/harmonic_balance.py), 12 and 20 harmonics agreeing to "
        "1e-10; SciPy's DOP853 closes the orbit to 1e-13",
        chosen={
            "amplitude": Choice(0.2e-6, "m", "of the walls"),
            "frequency": Choice(7290.0, "Hz", "of the walls; the infinite chain's cut-off is 7369 Hz"),
        },
        binding=("amplitude", "frequency"),
        size=(9.2, 3.8),
    ),
    Figure(
        label="breather.3",
        title="Bright breather of a dimer chain, its multipliers and its unstable mode",
        caption="(a) Displacements of the light-centred breather of a precompressed dimer, A = d0 = light mass = 1, "
        "constant force at the ends, in the gap below the optical band; (b) Floquet multipliers; (c) displacements and "
        "(d) velocities of the unstable mode.",
        compute=bright,
        draw=_draw_bright,
        number=largest_multiplier,
        quantity="largest Floquet multiplier (real)",
        expected=1.126536,
        tolerance=2e-6,
        source="an independent shooting method with a converged step",
        chosen={
            "beads": Choice(121, "", "beads of the chain, light at both ends and in the middle"),
            "heavy": Choice(2.957949, "", "mass of the heavy beads"),
            "frequency": Choice(0.985, "omega_2", "of the breather, in units of the optical edge sqrt(3)"),
        },
        binding=("beads", "heavy", "frequency"),
        size=(8.4, 6.4),
    ),
)
