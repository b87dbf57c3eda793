"""Kicks, drifts and Ornstein-Uhlenbeck substeps, and the methods composed of them."""
