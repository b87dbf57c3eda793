"""Differential-algebraic problems: Hessenberg forms, mechanics with constraints, F(t, y, y′) = 0."""
