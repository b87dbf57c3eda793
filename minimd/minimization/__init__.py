"""Downhill to a minimum of the potential energy."""
