"""Files that others wrote: what they hold is checked, and what reads them cannot take the session with it."""

from .reader import dataset, matlab
from .tables import Table, named, table

__all__ = ["Table", "dataset", "matlab", "named", "table"]
