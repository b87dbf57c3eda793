"""Scene files (TOML), checked by pydantic: what they describe, without running it."""
