"""The user interface of minimd: runs, equilibration, minimization, report."""
