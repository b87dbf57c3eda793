"""Analysis of the file of a run: the check through MDAnalysis, and pictures."""
