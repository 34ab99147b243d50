"""Studies that stand on the library: experiments on driven chains, the resonance of a dimer (`gx.resonance`)."""

from .bright_breather import BrightBreather, bright_by_instability
from .bullet import SoundBullet, sound_bullet
from .dark_breather import DarkBreather, dark_by_interference, steel_chain
from .gates import Switch, TruthTable, switch, truth_table
from .rectifier import Rectifier, rectifier, rectifier_branch
from .spreading import Exponent, Spreading, spreading
from .two_way import TwoWay, two_way

__all__ = [
    "BrightBreather", "DarkBreather", "Rectifier", "SoundBullet", "Switch", "TruthTable", "TwoWay",
    "bright_by_instability", "dark_by_interference", "rectifier", "rectifier_branch", "sound_bullet", "steel_chain",
    "switch", "truth_table", "two_way",
]
