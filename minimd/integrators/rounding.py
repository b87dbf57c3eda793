"""The rounding of numbers."""

import numpy as np

EPS = float(np.finfo(float).eps)  # of 1: the relative spacing of numbers
