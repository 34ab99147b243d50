"""Files that others wrote: what they hold is checked, and what reads them cannot take the session with it."""

from .reader import Column, Stored, arrays, columns, dataset, regular
from .tables import Table, named, table

__all__ = ["Column", "Stored", "Table", "arrays", "columns", "dataset", "named", "regular", "table"]
