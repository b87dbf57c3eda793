"""The face of minimd: runs, equilibration, minimization, report."""
