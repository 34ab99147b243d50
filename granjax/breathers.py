"""Breathers: time-periodic, localised orbits of conservative lattices, their families and their stability."""

from .orbits import Bifurcation, Branch, Orbit, guesses
from .orbits.backbone import Backbone, backbone
from .orbits.branch import bifurcations
from .orbits.families import QBreather, anticontinuous, bands_of, breather, family, q_breather
from .orbits.gap_breather import GapBreather, k_gap_breather
from .orbits.guesses import bright_guess, dark_guess
from .orbits.localised import Localisation, localisation

__all__ = [
    "Backbone",
    "Bifurcation",
    "Branch",
    "GapBreather",
    "Localisation",
    "QBreather",
    "Orbit",
    "anticontinuous",
    "backbone",
    "bands_of",
    "bifurcations",
    "breather",
    "bright_guess",
    "dark_guess",
    "family",
    "guesses",
    "k_gap_breather",
    "localisation",
    "q_breather",
]
