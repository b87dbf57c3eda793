"""Minimization of the potential energy."""
