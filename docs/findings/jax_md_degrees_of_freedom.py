"""JAX MD: nvt_nose_hoover counts 3N degrees of freedom, but keeps the total momentum at zero, where it starts.

Four atoms in a ring of quartic bonds, kT = 1. Right would be 2<K>/(3N − 3) = 1; it is 3N/(3N − 3) = 1.33. nvt_langevin,
which does not keep the momentum, is right.
Cure: quantity.count_dof less the dimension, where the momentum is centered (as initialize_momenta does)."""

import jax
from jax import numpy as jnp
from jax_md import simulate

jax.config.update("jax_enable_x64", True)
N, STEPS = 4, 1_000_000


def energy(x, **_):
    """Of the ring."""
    d2 = ((x - jnp.roll(x, 1, axis=0)) ** 2).sum(axis=1)
    return (0.5 * d2 + 0.25 * d2**2).sum()


for simulator in (simulate.nvt_nose_hoover, simulate.nvt_langevin):
    rate = {"gamma": 1.0} if simulator is simulate.nvt_langevin else {"tau": 1.0}
    start, step = simulator(energy, lambda x, dx, **_: x + dx, 0.05, 1.0, **rate)

    def advance(_, both, step=step):
        """One step; the sum of K."""
        state, total = both
        state = step(state)
        return state, total + 0.5 * (state.momentum**2).sum()

    state = start(jax.random.PRNGKey(1), jnp.zeros((N, 3)))
    state, _ = jax.lax.fori_loop(0, 10_000, advance, (state, 0.0))
    state, total = jax.lax.fori_loop(0, STEPS, advance, (state, 0.0))
    momentum = jnp.abs(state.momentum.sum(axis=0)).max()
    moving = 3 * N if momentum > 1e-6 else 3 * N - 3
    print(
        f"{simulator.__name__:16} total momentum {momentum:.0e}: 2<K>/({moving} kT) = {2 * total / STEPS / moving:.3f}"
    )
