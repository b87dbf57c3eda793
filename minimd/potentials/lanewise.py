"""Which laws run on vectors as they are, and how the others do: lane by lane."""

import functools

import numpy as np
from numba.core.errors import NumbaError

from minimd.compiled.kernels import by_type, kernel, scalar, without_cache
from minimd.compiled.simd import lane, load, total, with_lane
from minimd.compiled.simd.vector import count, lanes_for
from minimd.potentials.law import evaluate_law, law_type
from minimd.potentials.tabulated import reads_table
from minimd.potentials.user_laws import is_recognized, is_user_law


@scalar
def each_lane(x, law, parameters):
    """A law of numbers on a vector of them.  parameters : tuple of vectors."""
    u = f = x
    for k in range(count(x)):
        v, g = evaluate_law(law, lane(x, k), _in_lane(parameters, k))
        u, f = with_lane(u, k, v), with_lane(f, k, g)
    return u, f


@by_type
def _in_lane(parameters, k):
    """The numbers in lane k of a tuple of vectors; unrolled by the compiler."""
    if len(parameters) == 0:
        return lambda parameters, k: ()
    return lambda parameters, k: (lane(parameters[0], k),) + _in_lane(parameters[1:], k)


EachLane = law_type("EachLane", each_lane)


def on_vectors(law: tuple, n_parameters: int) -> tuple:
    """A law type that runs on vectors: the law, or EachLane of it."""
    return law if runs_on_vectors(law, n_parameters) else EachLane(law)


@kernel
def sum_over_lanes(law, distances2, parameters, lanes):
    """Σ (u + f) of a law at as many squared distances [length²] as lanes: compiles only if it runs on vectors."""
    u, f = evaluate_law(law, load(distances2, 0, lanes), parameters)
    return total(u) + total(f)


@functools.cache
def runs_on_vectors(law: tuple, n_parameters: int) -> bool:
    """Whether a law compiles for vectors: minimd's do, but for tables; one that branches on its arguments does not."""
    if reads_table(law):
        return False
    if not is_user_law(law):
        return True
    lanes = lanes_for()
    attempt = sum_over_lanes if is_recognized(law) else without_cache(sum_over_lanes)
    try:
        attempt(law, np.ones(lanes.size), (1.0,) * n_parameters, lanes)
    except NumbaError:
        return False
    return True
