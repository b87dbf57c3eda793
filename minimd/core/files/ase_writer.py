"""Trajectories that ASE writes."""

from typing import Any

import ase.io
from ase import Atoms
from ase.calculators.singlepoint import SinglePointCalculator
from ase.io.trajectory import TrajectoryWriter

from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Frame
from minimd.core.files.claim import Claim
from minimd.core.files.trajectory import Writer
from minimd.core.structure.ase_atoms import atoms_from_system, calculators_stress, label_by_tags


def atoms_of_frame(template: Atoms, frame: Frame, forces: Any, conserves_momentum: bool) -> Atoms:
    """A copy of ASE's atoms in the state of a frame, with step and time in info, and energy, forces and stress, where
    they are known, as results of a calculator.
    conserves_momentum : whether the run did."""
    atoms = template.copy()
    observables = frame.observables
    atoms.positions[:] = frame.positions
    if frame.cell is not None:
        atoms.cell[:] = frame.cell.vectors
    atoms.set_momenta(frame.velocities * atoms.get_masses()[:, None], apply_constraint=False)
    atoms.info.update(step=frame.step, time=frame.time)
    stress = None
    if "stress" in observables:
        stress = calculators_stress(observables["stress"], atoms, conserves_momentum)
    atoms.calc = SinglePointCalculator(
        atoms, energy=float(observables["potential_energy"]), forces=forces, stress=stress
    )
    return atoms


class ASEWriter(Writer):
    """A trajectory written by ASE, in the units of the system: .traj in float64, .xyz and .extxyz as extended XYZ,
    with 8 decimals.

    Each frame holds positions (not wrapped), momenta, masses, charges, cell, constraints (in .traj all, but without
    lengths; else only fixed atoms), bonds and angles as texts (not in .traj), the potential energy as the result of a
    calculator, forces if they are to be stored, the stress if it is observed, and step and time in info. Species that
    are not elements are stored as labels; in .traj, their names are in info, and the tag of each atom is the index of
    its name.

    claim : on the file, which gets its name with its first frame.
    """

    def __init__(self, claim: Claim, engine: Engine, store_forces: bool) -> None:
        self.claim = claim
        self._template = atoms_from_system(engine.system)
        self._store_forces = store_forces
        self._conserves_momentum = engine.conserves_momentum
        self._output: Any
        if claim.path.suffix.lower() == ".traj":
            label_by_tags(self._template, engine.system)
            self._output = TrajectoryWriter(claim.stream, "w")
        else:
            self._output = claim.stream.open("w", encoding="utf-8")

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        forces = frame.forces if self._store_forces else None
        atoms = atoms_of_frame(self._template, frame, forces, self._conserves_momentum)
        if isinstance(self._output, TrajectoryWriter):
            self._output.write(atoms)
        else:
            ase.io.write(self._output, atoms, format="extxyz")
            self._output.flush()  # a killed run leaves whole frames
        self.claim.check()
        self.claim.appear()

    def close(self) -> None:
        """Finish the file."""
        try:
            self._output.close()
        finally:
            self.claim.release()
