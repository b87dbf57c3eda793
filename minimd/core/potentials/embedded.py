"""Potentials of metals: atoms embedded in the density that their neighbors give them, from functions or from files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import listed, shown
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import declared
from minimd.core.potentials.embedded_files import EmbeddedTables, read_tables
from minimd.core.potentials.embedded_laws import (
    EmbeddedLaw,
    FinnisSinclairDensity,
    FinnisSinclairEmbedding,
    FinnisSinclairPair,
    GuptaDensity,
    GuptaEmbedding,
    GuptaPair,
    SuttonChenDensity,
    SuttonChenEmbedding,
    SuttonChenPair,
    TabulatedBothWays,
    TabulatedEmbedded,
    TabulatedEmbedding,
    parts,
)
from minimd.core.potentials.law import (
    check_law_of_density,
    check_user_law,
    checked_law,
    evaluate_law,
    law_at,
)
from minimd.core.potentials.pair import (
    CUTOFF,
    TRUNCATION,
    UNSCALED,
    ByLabel,
    Cutoff,
    Label,
    Nonbonded,
    PairPotential,
    PairTerm,
    Parameters,
)
from minimd.core.potentials.splines import cubics
from minimd.core.potentials.term import Embedding
from minimd.core.potentials.truncation import TRUNCATIONS, TruncationName
from minimd.core.structure.checks import checked_number
from minimd.core.structure.system import System

LAW = "'sutton-chen', 'finnis-sinclair' or 'gupta'; or three functions: of a pair, of the density, of the embedding"
OF_SPECIES = "a tuple, or a mapping from species to them"
NEIGHBORS = 12.0  # of an atom in a metal: how often the density of one is tried


class EmbeddedLaws(NamedTuple):
    """The three law types of a potential of embedded atoms, which take the same parameters.

    pair : φ(r), see embedded_laws.
    density : g(r).
    embedding : F(ρ).
    parameters : their names; empty for a user's functions.
    lengths : the names of those that are lengths, and positive.
    """

    pair: Any
    density: Any
    embedding: Any
    parameters: tuple[str, ...] = ()
    lengths: tuple[str, ...] = ()


FORMS = {
    "sutton-chen": EmbeddedLaws(
        SuttonChenPair(),
        SuttonChenDensity(),
        SuttonChenEmbedding(),
        ("epsilon", "a", "c", "n", "m"),
        ("a",),
    ),
    "finnis-sinclair": EmbeddedLaws(
        FinnisSinclairPair(),
        FinnisSinclairDensity(),
        FinnisSinclairEmbedding(),
        ("A", "d", "beta", "c", "c0", "c1", "c2"),
        ("d", "c"),
    ),
    "gupta": EmbeddedLaws(
        GuptaPair(), GuptaDensity(), GuptaEmbedding(), ("A", "xi", "p", "q", "r0"), ("r0",)
    ),
}
FormName = Literal["sutton-chen", "finnis-sinclair", "gupta"]  # the keys of FORMS
OwnLaws = tuple[Callable, Callable, Callable]


class EmbeddedAtom(Nonbonded):
    """Metals: U = Σ_pairs φ(r) + Σ_atoms F(ρ), where each atom has the density ρ = Σ g(r) of its neighbors.

    M. S. Daw, M. I. Baskes, Phys. Rev. B 29, 6443 (1984); M. W. Finnis, J. E. Sinclair, Philos. Mag. A 50, 45 (1984).
    A law by name has these parameters:

        'sutton-chen'       (epsilon, a, c, n, m)
            φ = ε (a/r)ⁿ,  g = (a/r)ᵐ,  F = −ε c √ρ
        'finnis-sinclair'   (A, d, beta, c, c0, c1, c2)
            φ = (r − c)² (c₀ + c₁ r + c₂ r²) for r < c,  g = (r − d)² + β (r − d)³/d for r < d,  F = −A √ρ
        'gupta'             (A, xi, p, q, r0)
            φ = 2 A exp[−p (r/r₀ − 1)],  g = ξ² exp[−2q (r/r₀ − 1)],  F = −√ρ

    Functions of your own take the same parameters, too: pair(r2, *parameters) returns φ and −φ′(r)/r, density(r2, ...)
    g and −g′(r)/r, embedding(rho, *parameters) F and F′(ρ). Truncation acts on φ and on g. Published parameters mean
    truncation="truncated", unless their source says otherwise. Files: EmbeddedAtom.from_file.
    """

    alone: ClassVar[Parameters] = (0.0, 0.0)
    law: FormName | OwnLaws = declared(kind.given, of=LAW)
    parameters: Parameters | ByLabel = declared(kind.given, of=OF_SPECIES, default=())
    cutoff: Cutoff | None = CUTOFF
    truncation: TruncationName = TRUNCATION
    bonded_scale: Sequence[float] = declared(kind.factors, init=False, default=UNSCALED)
    exclusions: ArrayLike | None = declared(kind.pairs, init=False, default=None)
    tail_correction: bool = declared(kind.flag, init=False, default=False)

    @classmethod
    def from_file(cls, file: str | os.PathLike[str]) -> EmbeddedAtom:
        """The potential in a file for LAMMPS' eam, eam/alloy or eam/fs (funcfl, setfl), for systems in units of ASE.

        The format is told by what the file holds, not by its name. Between the points of the tables are the cubics of
        LAMMPS, so that both give the same energies in all digits.
        Raises OSError for a file that cannot be read; ValueError for one that holds something else.
        """
        return EmbeddedAtom.of_tables(read_tables(file))

    @staticmethod
    def of_tables(tables: EmbeddedTables) -> EmbeddedAtom:
        """The potential in tables in units of ASE."""
        return EmbeddedAtomOfTables(tables)

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        self.given: Any = self.law
        if isinstance(self.mixing, str):
            raise ValueError(
                "mixing of EmbeddedAtom must be a function of the tuples of two species, or pairs={...} in its place; "
                f"mixing = {self.mixing!r} is for Lennard-Jones"
            )
        self.laws = _checked_laws(self.given)
        return EmbeddedLaw(self.laws.pair, self.laws.density), self.parameters, self.pairs

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        """See Nonbonded."""
        values = super()._checked_numbers(numbers, of)
        names = self.laws.parameters
        whose = f"of {self.given!r}" + ("" if of is None else f" for {of!r}")
        if names and len(values) != len(names):
            raise ValueError(
                f"parameters {whose} must be {len(names)} numbers, ({', '.join(names)}); they are {shown(numbers)}"
            )
        for name in self.laws.lengths:
            checked_number(f"{name} {whose}", values[names.index(name)], "positive and finite")
        return values

    def _truncated_law(self) -> Any:
        """See Nonbonded."""
        around = TRUNCATIONS[self.truncation].around
        return type(self.plain_law)(around(self.laws.pair), around(self.laws.density))

    def _numbers_of_laws(self, parameters: Parameters, cutoff: float) -> Parameters:
        of_pair = self._truncated(self.laws.pair, parameters, cutoff)
        return (*of_pair, *self._truncated(self.laws.density, parameters, cutoff))

    def _try_laws(self, parameters: Parameters, distances: Sequence[float]) -> None:
        check_user_law(self.laws.pair, parameters, distances)
        check_user_law(self.laws.density, parameters, distances)
        of_one = [law_at(self.laws.density, r, parameters)[0] for r in distances]
        check_law_of_density(self.laws.embedding, parameters, [NEIGHBORS * g for g in of_one])

    def embedding(self, species_names: Sequence[Label]) -> Embedding:
        """See Nonbonded."""
        if not isinstance(self.parameters, dict):
            return Embedding(self.laws.embedding, np.array([self.parameters]))
        table = [self.parameters[name] for name in species_names]
        return Embedding(self.laws.embedding, np.array(table))

    def _energy_at(self, r: float, numbers: Parameters, first: Any, second: Any) -> float:
        """φ(r) + F(gᵢ) + F(gⱼ): of two atoms that are alone."""
        energy = super()._energy_at(r, numbers, first, second)
        for name, density in zip((first, second), self._densities(r, numbers), strict=True):
            of_embedding = tuple(self.embedding([name]).table[0].tolist())
            energy += evaluate_law(self.laws.embedding, density, of_embedding)[0]
        return energy

    def _densities(self, r: float, numbers: Parameters) -> tuple[float, float]:
        """What two atoms at a distance give each other."""
        law: Any = self.law
        density = law_at(law.density, r, parts(numbers)[1])[0]
        return density, density

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return super().arguments() | {"law": self.given}


class EmbeddedAtomOfTables(EmbeddedAtom):
    """Embedded atoms from the tables of a file, see EmbeddedAtom.from_file."""

    law: EmbeddedTables = declared(kind.given, of="the tables of a file")  # type: ignore[assignment]
    parameters: Parameters | ByLabel = declared(kind.given, init=False, default=())
    cutoff: Cutoff | None = declared(kind.given, init=False, default=None)
    truncation: TruncationName = declared(kind.given, init=False, default="truncated")
    mixing: None = declared(kind.given, init=False, default=None)
    pairs: None = declared(kind.given, init=False, default=None)
    switch_start: None = declared(kind.given, init=False, default=None)

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded: the parameters of a pair are the rows of its functions."""
        tables = self.given = self.law
        self.cutoff = tables.cutoff
        pairs = [*tables.pairs()]
        on_r = cubics(tables.dr, [functions for _, _, functions in pairs], tables.cutoff)
        on_rho = cubics(tables.drho, tables.embedding[:, None])
        n_rows = len(on_r.rows) // len(pairs)
        rows = {(a, b): float(k * n_rows) for k, (a, b, _) in enumerate(pairs)}
        n_steps = len(on_rho.rows) // len(tables.elements)
        own = {element: (float(k * n_steps),) for k, element in enumerate(tables.elements)}
        self.laws = EmbeddedLaws(None, None, TabulatedEmbedding(on_rho))
        if tables.is_symmetric:
            return TabulatedEmbedded(on_r), own, {pair: (row,) for pair, row in rows.items()}
        both_orders = {(a, b): (row, rows[b, a]) for (a, b), row in rows.items()}
        return TabulatedBothWays(on_r), own, both_orders

    def bind(self, system: System) -> PairTerm:
        """See Nonbonded. Raises ValueError also for a system in other units than eV and Å, those of the tables."""
        if system.units.is_reduced:
            raise ValueError(
                f"the tables of {self.given.file!r} are in eV and Å; the system must be in the units of ASE, it is in "
                f"{system.units.name}"
            )
        return super().bind(system)

    def _checked_parameters(
        self, parameters: Any, pairs: Any
    ) -> tuple[Parameters | dict[Label, Parameters], dict]:
        """See Nonbonded: those of a pair differ from those of the reverse pair."""
        return parameters, pairs

    def _truncated_law(self) -> Any:
        """See Nonbonded."""
        return self.plain_law

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        for name in (a, b):
            if name not in self.parameters:
                raise ValueError(
                    f"the tables of {self.given.file!r} are of {listed(self.parameters)}, the system has species "
                    f"{name!r}: species must have the names of elements"
                )
        return self._by_pair[a, b]

    def _numbers_of_laws(self, parameters: Parameters, cutoff: float) -> Parameters:
        return parameters

    def _densities(self, r: float, numbers: Parameters) -> tuple[float, float]:
        law: Any = self.law
        first, second = law.densities.py_func(r * r, law.table, (*self.alone, *numbers))
        return first, second

    def __repr__(self) -> str:
        return f"EmbeddedAtom.from_file({self.given.file!r})"


def _checked_laws(given: Any) -> EmbeddedLaws:
    """The law types of a name, or of three functions.
    Raises ValueError or TypeError for anything else."""
    if isinstance(given, str) and given in FORMS:
        return FORMS[given]
    if not (isinstance(given, tuple | list) and len(given) == 3):
        kind = ValueError if isinstance(given, str) else TypeError
        raise kind(
            "law of EmbeddedAtom must be one of "
            f"{', '.join(map(repr, FORMS))}, or three functions (pair, density, embedding); law = {shown(given)}; "
            "a file is read by EmbeddedAtom.from_file(file)"
        )
    return EmbeddedLaws(*map(checked_law, given))


PairPotential.register(EmbeddedAtom)
