"""The review's sixteen figures by their labels."""

from ...checks import one_of
from ...entry import checked
from . import breather_figures, dimer_pulse, dimer_transmission, monomer_pulse, shock_figures, solitary
from .figure import Figure

_FIGURES = (
    *solitary.FIGURES, *monomer_pulse.FIGURES, *dimer_transmission.FIGURES, *dimer_pulse.FIGURES,
    *breather_figures.FIGURES, *shock_figures.FIGURES,
)

_LABELS = (
    "fig1.2", "fig1.3", "fig1.4", "fig1.5", "fig2.2", "fig2.3", "fig2.4", "fig2.5",
    "breather.1", "breather.2", "breather.3", "DSW.1", "DSW.2", "DSW.3", "DSW.4", "DSW.5",
)

_BY_LABEL = {figure.label: figure for figure in _FIGURES}


def figures() -> dict[str, Figure]:
    """A dict from label to `Figure`, in the order of the review.

    **Example:**

    >>> figures = gx.reproduce.figures()
    >>> len(figures), next(iter(figures))
    (16, 'fig1.2')
    """
    return {label: _BY_LABEL[label] for label in _LABELS}


@checked
def figure(label: str) -> Figure:
    """The figure of a label. **Raises** ValueError for an unknown label, naming the nearest.

    **Example:**

    >>> print(gx.reproduce.figure("fig1.3").title)
    Space-time evolution of the exact travelling wave, strain, c = 1
    """
    return _BY_LABEL[one_of("label", label, _LABELS)]


def listing() -> str:
    """A table of all figures as text: label, title, what it chooses.

    **Example:**

    >>> print(gx.reproduce.listing().splitlines()[0])
    fig1.2     The travelling wave's profile, its derivative and its tail
    """
    lines = []
    for label, found in figures().items():
        lines.append(f"{label:<11}{found.title}")
        for name, choice in found.chosen.items():
            lines.append(f"{'':11}  {name} = {choice.value}{_unit(choice)}, {choice.about}")
    return "\n".join(lines)


def _unit(choice):
    return f" {choice.unit}" if choice.unit else ""
