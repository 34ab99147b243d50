"""The review's sixteen figures by their labels: those that are made, and those that wait for a capability."""

from ...checks import one_of, refuse
from ...entry import checked
from . import breather_figures, dimer_pulse, dimer_transmission, monomer_pulse, solitary
from .figure import Awaited, Figure

_MADE = (
    *solitary.FIGURES, *monomer_pulse.FIGURES, *dimer_transmission.FIGURES, *dimer_pulse.FIGURES,
    *breather_figures.FIGURES,
)

_AWAITED = (
    Awaited("DSW.1", "Dispersive shock from a step", "dispersive shocks"),
    Awaited("DSW.2", "Two zooms into the dispersive shock", "dispersive shocks"),
    Awaited("DSW.3", "Granular velocity shock and its KdV prediction", "dispersive shocks"),
    Awaited("DSW.4", "Granular velocity shock and its Toda approximation", "dispersive shocks"),
    Awaited("DSW.5", "Edges of the granular velocity shock, KdV and Toda", "dispersive shocks"),
)

_LABELS = (
    "fig1.2", "fig1.3", "fig1.4", "fig1.5", "fig2.2", "fig2.3", "fig2.4", "fig2.5",
    "breather.1", "breather.2", "breather.3", "DSW.1", "DSW.2", "DSW.3", "DSW.4", "DSW.5",
)

_BY_LABEL = {figure.label: figure for figure in (*_AWAITED, *_MADE)}


def figures() -> dict[str, Figure | Awaited]:
    """A dict from label to `Figure`, or to `Awaited` where it is not made yet, in the order of the review."""
    return {label: _BY_LABEL[label] for label in _LABELS}


@checked
def figure(label: str) -> Figure:
    """The figure of a label. **Raises** ValueError for an unknown label, naming the nearest, or one not made yet."""
    found = _BY_LABEL[one_of("label", label, _LABELS)]
    if isinstance(found, Awaited):
        refuse("label", f"one that is made ({', '.join(made())})", repr(label),
               f"{label} is not made yet: it needs {found.needs}.")
    return found


def made() -> tuple[str, ...]:
    """Labels of the figures that are made, in the order of the review."""
    return tuple(label for label in _LABELS if isinstance(_BY_LABEL[label], Figure))


def listing() -> str:
    """A table of all figures as text: label, whether it is made, title, what it chooses."""
    lines = []
    for label, found in figures().items():
        if isinstance(found, Awaited):
            lines.append(f"{label:<11}not yet  {found.title} (needs {found.needs})")
            continue
        lines.append(f"{label:<11}made     {found.title}")
        for name, choice in found.chosen.items():
            lines.append(f"{'':20}{name} = {choice.value}{_unit(choice)}, {choice.about}")
    return "\n".join(lines)


def _unit(choice):
    return f" {choice.unit}" if choice.unit else ""
