"""The entry of public functions: what is given for an argument is of the kind that its annotation says.

`checked` reads the annotations of a function once and makes a test of each; the words are those of `granjax.types`. A
wrong kind meets a sentence before anything is computed, traced or converted. A number that is not known yet (traced)
passes where an array is meant. What a number must be beyond its kind (positive, within) is the function's own check.
"""

from .checked import checked, kind_of, takes
from .kinds import shape_of

__all__ = ["checked", "kind_of", "shape_of", "takes"]
