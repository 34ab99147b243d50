"""What is computed, kept and sent at a time: the results of some lanes of a sweep."""

from typing import NamedTuple

import numpy as np

from ..printing import told as _told

# in `told` of a chunk that could not be computed where it was sent: another time it may be
LOST = ""


class Chunk(NamedTuple):
    """The results of some lanes.

    - `columns`: from name to an array of numbers or words, lanes first, (lanes, ...).
    - `reasons`: a sentence for each lane that failed, "" for all others.
    - `told`: from name to what is known of a column: its own axes ("dims"), its unit ("units").

    **Example:**

    >>> chunk = gx.sweeps.Chunk({"peak": np.array([0.5, 0.6])}, ["", ""], {"peak": {"units": "N"}})
    >>> chunk.columns["peak"].shape, chunk.told["peak"]
    ((2,), {'units': 'N'})
    """

    columns: dict[str, np.ndarray]
    reasons: list[str]
    told: dict[str, dict]
    __repr__ = _told
