"""The surface tension of a film, from the stress."""

from __future__ import annotations

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look, check_has_volume
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count
from minimd.core.structure.statistics import with_error
from minimd.core.structure.units import MN_PER_M
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import AXES, argument, axis_name, label, steps
from minimd.observers.means import Means, MeansResult, Quantity

UPRIGHT = 1e-6  # largest cosine of the angle between the axis and the other lattice vectors
TAILS = "the part of the interactions beyond their cutoffs is left out"


class SurfaceTensionResult(MeansResult):
    """A surface tension, tension, and the pressure along the axis, normal_pressure, see MeansResult."""

    title = "surface tension"

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = super().display_rows()
        if self.units.name == "ASE":
            shown = with_error(self.tension / MN_PER_M, self.tension_error / MN_PER_M)
            rows.insert(1, ("", f"γ = {shown} mN/m"))
        return [*rows, ("", TAILS)]


class SurfaceTension(Means):
    """Surface tension of a film whose surfaces are normal to an axis of the cell, from the anisotropy of the stress.

        γ = L/n ⟨P_N − P_T⟩,   P = −σ

    L is the height of the cell along the axis, n the number of surfaces, P_N the pressure along the axis and P_T the
    mean of those along the surface. γ is that of the interactions as they are: what lies beyond their cutoffs is left
    out. A tail correction of the pressure is the same in all directions, and changes nothing.

    J. G. Kirkwood, F. P. Buff, J. Chem. Phys. 17, 338 (1949); J. Alejandre, D. J. Tildesley, G. A. Chapela, J. Chem.
    Phys. 102, 4574 (1995), on films.

    Raises ValueError for arguments out of range; when a run begins, for a cell without a volume, or whose axis is not
    perpendicular to the two other lattice vectors.
    """

    kind = "surface-tension"
    answer = SurfaceTensionResult
    needs_energy = True
    axis: str = argument(axis_name, "the lattice vector a, b or c, normal to the surfaces", "c")
    n_surfaces: int = argument(checked_count, "number of surfaces", 2)
    every: int = steps(10)
    name: str = label()

    def _begin(self, engine: Engine) -> None:
        check_has_volume(engine)
        vectors = engine.system.cell.vectors
        k = AXES.index(self.axis)
        along = vectors[k] / np.linalg.norm(vectors[k])
        others = np.delete(vectors, k, axis=0)
        cosines = np.abs(others @ along) / np.linalg.norm(others, axis=1)
        if cosines.max() > UPRIGHT:
            angle = np.degrees(np.arccos(cosines.max()))
            raise ValueError(
                f"axis must be perpendicular to the other two lattice vectors; axis = {self.axis!r} has an angle of "
                f"{angle:.4g}° with one: choose another axis, or a cell that is upright"
            )

    def _quantities(self, scene: ObservedRun) -> list[Quantity]:
        units = scene.unit_system
        return [
            Quantity("tension", "γ", f"{units.energy}/{units.length}²"),
            Quantity("normal_pressure", "P_N", units.pressure),
        ]

    def _values(self, engine: Engine) -> Array:
        engine.evaluate()
        stress = Look(engine).stress
        along = engine.system.cell.vectors[AXES.index(self.axis)]
        height = np.linalg.norm(along)
        normal = -(along @ stress @ along) / height**2
        tangential = -0.5 * (np.trace(stress) + normal)
        return np.array([height * (normal - tangential) / self.n_surfaces, normal])
