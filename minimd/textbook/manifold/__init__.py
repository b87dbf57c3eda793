"""Motion on manifolds: holonomic constraints, projection onto invariants."""
