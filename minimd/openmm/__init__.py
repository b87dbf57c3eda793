"""The bridge to OpenMM: its systems as systems and potentials of minimd, so any force field that it reads."""
