"""One system, its forces, its constraints and one method: what advances, and what is observed of it."""
