"""What can be said about a run: conservation, cutoffs, time step, shadow energy, reversibility, causes of a failure."""
