"""Charges of atoms, which minimd does not use yet."""

import warnings

import numpy as np
from numpy.typing import ArrayLike

from minimd.console.quiet import outside_minimd

NO_ELECTROSTATICS = "minimd has no electrostatics yet"


def warn_of_charges(charges: ArrayLike) -> None:
    """Warn that the charges of atoms [e] are not used, unless all are zero."""
    if (largest := np.abs(charges).max(initial=0.0)) > 0.0:
        words = f"the charges of the atoms, up to {largest:.4g} e, are not used: {NO_ELECTROSTATICS}"
        warnings.warn(words, stacklevel=outside_minimd())
