"""JAX MD: temp_csvr draws its normal number r1 and the sum of squares r2 with one key.

If 3N − 1 is odd, the same number is counted in r1² and in r2. Two free atoms with momenta that are drawn from kT = 1 (6
degrees of freedom all move, as nothing centers them): K has mean 3 and variance 3 in the canonical ensemble.
Cure: key, first, second = random.split(state.rng, 3), and first for r1, second for r2; sum_noises
splits its key, too, for its normal and its gamma number."""

import jax
from jax import numpy as jnp
from jax_md import simulate

jax.config.update("jax_enable_x64", True)
STEPS, TAU = 4_000_000, 1.0
start, step = simulate.temp_csvr(lambda x, **_: 0.0 * x.sum(), lambda x, dx, **_: x + dx, 1.0, 1.0, tau=TAU)


def advance(_, both):
    """One step; sums of K and K²."""
    state, sums = both
    state = step(state)
    kinetic = 0.5 * (state.momentum**2).sum()
    return state, sums + jnp.array([kinetic, kinetic**2])


momenta = jax.random.normal(jax.random.PRNGKey(2), (2, 3))
state = start(jax.random.PRNGKey(1), jnp.zeros((2, 3)), momenta=momenta)
_, (mean, square) = jax.lax.fori_loop(0, STEPS, advance, (state, jnp.zeros(2)))
mean, square = mean / STEPS, square / STEPS
print(f"<K> = {mean:.3f} (right: 3), variance of K = {square - mean**2:.3f} (right: 3)")
