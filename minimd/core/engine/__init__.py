"""The engine (one system, its forces, its constraints and one method) and the observables of its state."""
