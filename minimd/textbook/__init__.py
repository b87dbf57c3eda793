"""Integrators of small systems, whose forces are Python functions: ode, dae, manifold; the table of all methods."""
