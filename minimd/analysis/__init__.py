"""What is read from the file of a run: the check through MDAnalysis, pictures."""
