"""Lengths and atoms that are held fixed, each shape with the solver that suits it."""
