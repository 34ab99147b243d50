"""Coefficients of the methods, as published, with their sources."""

import json
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np


@cache
def _read():
    return json.loads(resources.files(__package__).joinpath("coefficients.json").read_text())


class Splitting(NamedTuple):
    """A splitting method.

    One step: kick b[0], drift a[0], kick b[1], ..., drift a[s-1], kick b[s], in units of the step.
    """

    a: np.ndarray
    b: np.ndarray
    order: int
    source: str


class Nystrom(NamedTuple):
    """k_i = F(u + c_i h v + h^2 A_ij k_j)/m; weights b, bp of u, v and be, bpe of their errors."""

    A: np.ndarray
    b: np.ndarray
    bp: np.ndarray
    be: np.ndarray
    bpe: np.ndarray
    c: np.ndarray
    order: int
    embedded_order: int
    source: str


def _table(kind, name):
    found = _read()[kind.__name__.lower()][name]
    # Coefficients are lists of decimals, all else is as it stands.
    own = [found[key] for key in kind._fields]
    return kind(*(np.array(x, float) if isinstance(x, list) else x for x in own))


def splitting(name: str) -> Splitting:
    """Return the table of a splitting method by the name of its class."""
    return _table(Splitting, name)


def nystrom(name: str) -> Nystrom:
    """Return the table of a Runge-Kutta-Nystrom pair by the name of its class."""
    return _table(Nystrom, name)
