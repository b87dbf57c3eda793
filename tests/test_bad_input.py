"""Bad input, of all the kinds that occur: one clear sentence that names quantity and value, never a traceback from the inside."""

import traceback
from pathlib import Path

import numpy as np
import pytest
from full_disk import fill_the_disk

import minimd as md
from minimd.files.h5md_reader import read_file

THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
NAN = float("nan")
LJ = md.LennardJones(1.0, 1.0, 2.5)
MASKED = np.ma.masked_equal(THREE, 1.2)
TWO_SPECIES = md.LennardJones({"Ar": (1.0, 1.0), "Kr": (1.0, 1.0)}, cutoff=2.5)


def simulate(positions=THREE, potentials=LJ, timestep=0.005, n_steps=10, cell=None, **keywords):
    """A short run."""
    simulation = md.Simulation(md.System(positions, cell=cell), potentials, md.VelocityVerlet(timestep))
    simulation.set_temperature(1.0, seed=1)
    return simulation.run(n_steps, progress=False, **keywords)


def coulomb(r2, q2):
    return q2 / r2**0.5, q2 / r2**1.5


def with_pairs(pairs):
    return md.LennardJones({"Ar": (1.0, 1.0), "Kr": (2.0, 1.1)}, cutoff=2.5, pairs=pairs)


def moved_by(distance):
    simulation = md.Simulation(md.System(THREE, cell=9.0), LJ, md.VelocityVerlet(0.005))
    simulation.positions[:] += distance
    simulation.run(1, progress=False)


def temperature_set_to(value):
    md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005)).set_temperature(value)


# what is done wrong: (the call, the exception, words that must be in its sentence)
WRONG_CALLS = {
    "two atoms on one spot": (
        lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3]], cell=10),
        md.NonFiniteError,
        ["atoms 1 and 2, 0 σ apart"],
    ),
    "two atoms on one spot, evaluated": (
        lambda: md.evaluate(md.System([[0, 0, 0], [3, 3, 3], [3, 3, 3]]), LJ),
        md.NonFiniteError,
        ["not finite", "atoms 1 and 2, 0 σ apart"],
    ),
    "two atoms on one spot of the next cell": (
        lambda: simulate([[0, 0, 0], [3, 3, 3], [10, 0, 0]], cell=10),
        md.NonFiniteError,
        ["atoms 0 and 2, 0 σ apart"],
    ),
    "two atoms nearly on one spot": (
        lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3.001]], cell=10),
        md.NonFiniteError,
        ["force on atom", "atoms 1 and 2, 0.001 σ apart"],
    ),
    "NaN position": (
        lambda: md.System([[0, 0, 0], [1, NAN, 0]]),
        ValueError,
        ["positions must be finite", "positions[1]", "nan"],
    ),
    "infinite position": (
        lambda: md.System([[0, np.inf, 0]]),
        ValueError,
        ["positions must be finite", "positions[0]", "inf"],
    ),
    "NaN velocity": (
        lambda: md.System(THREE, velocities=THREE * NAN),
        ValueError,
        ["velocities must be finite", "velocities[0]"],
    ),
    "no atoms": (lambda: md.System(np.zeros((0, 3))), ValueError, ["positions", "N > 0", "(0, 3)"]),
    "flat positions": (lambda: md.System([[0, 0], [1, 1]]), ValueError, ["positions", "(N, 3)", "(2, 2)"]),
    "positions that are words": (lambda: md.System([["a", "b", "c"]]), ValueError, ["positions", "(N, 3)", "'a'"]),
    "velocities of too few atoms": (
        lambda: md.System(THREE, velocities=[[0, 0, 0]]),
        ValueError,
        ["velocities", "3 atoms", "it has 1"],
    ),
    "zero mass": (
        lambda: md.System(THREE, masses=[1, 0, 1]),
        ValueError,
        ["masses must be positive", "masses[1] = 0.0"],
    ),
    "negative mass": (
        lambda: md.System(THREE, masses=[1, 1, -2]),
        ValueError,
        ["masses must be positive", "masses[2] = -2.0"],
    ),
    "NaN mass": (lambda: md.System(THREE, masses=NAN), ValueError, ["masses must be positive and finite", "nan"]),
    "masses of too few atoms": (lambda: md.System(THREE, masses=[1, 2]), ValueError, ["masses", "3", "(2,)"]),
    "mass that is a word": (
        lambda: md.System(THREE, masses="heavy"),
        ValueError,
        ["masses must be one number", "'heavy'"],
    ),
    "no masses in eV and Å": (
        lambda: md.System(THREE, units=md.units.ASE),
        ValueError,
        ["masses must be given in ASE units"],
    ),
    "wrong unit system": (lambda: md.System(THREE, units="SI"), TypeError, ["units must be", "'SI'"]),
    "species of too few atoms": (
        lambda: md.System(THREE, species=["Ar"]),
        ValueError,
        ["species must be 3 labels", "(1,)"],
    ),
    "species of several kinds": (
        lambda: md.System(THREE, species=["Ar", 1, None]),
        ValueError,
        ["species must be all strings", "None"],
    ),
    "flat cell": (
        lambda: md.System(THREE, cell=[[1, 0, 0], [0, 1, 0], [1, 1, 0]]),
        ValueError,
        ["linearly independent", "[1.0, 1.0, 0.0]"],
    ),
    "NaN cell": (lambda: md.System(THREE, cell=[10, NAN, 10]), ValueError, ["cell must be finite", "nan"]),
    "cell of two lengths": (lambda: md.System(THREE, cell=[10, 10]), ValueError, ["cell must be", "(2,)"]),
    "pbc without a cell": (lambda: md.System(THREE, pbc=True), ValueError, ["pbc[0] is True but cell[0] is zero"]),
    "bond to a missing atom": (
        lambda: md.System(THREE, bonds=[[0, 1], [1, 3]]),
        ValueError,
        ["bonds must name atoms 0 to 2", "bonds[1] = [1, 3]"],
    ),
    "bond of an atom with itself": (
        lambda: md.System(THREE, bonds=[[1, 1]]),
        ValueError,
        ["different atoms", "bonds[0] = [1, 1]"],
    ),
    "doubled bond": (
        lambda: md.System(THREE, bonds=[[0, 1], [1, 0]]),
        ValueError,
        ["each pair once", "[0, 1] is given 2 times"],
    ),
    "ragged bonds": (lambda: md.System(THREE, bonds=[[0, 1], [2]]), ValueError, ["bonds must be an (n, 2) array"]),
    "bond of fractions": (
        lambda: md.System(THREE, bonds=[[0, 1.5]]),
        ValueError,
        ["bonds must be an (n, 2) array", "fractions"],
    ),
    "masked positions": (lambda: md.System(MASKED), ValueError, ["positions must be", "some are masked"]),
    "masked rows in a list": (lambda: md.System(list(MASKED)), ValueError, ["positions must be", "some are masked"]),
    "masked number in a list": (
        lambda: md.System([[np.ma.masked, 0, 0]]),
        ValueError,
        ["positions must be", "some are masked"],
    ),
    "masked velocities": (
        lambda: md.System(THREE, velocities=MASKED),
        ValueError,
        ["velocities must be", "some are masked"],
    ),
    "masked masses": (
        lambda: md.System(THREE, masses=np.ma.masked_equal([1, 2, 3], 2)),
        ValueError,
        ["masses must be", "some are masked"],
    ),
    "masked cell": (
        lambda: md.System(THREE, cell=np.ma.masked_equal([9, 8, 9], 8)),
        ValueError,
        ["cell must be", "some are masked"],
    ),
    "masked bonds": (
        lambda: md.System(THREE, bonds=np.ma.masked_equal([[0, 1]], 1)),
        ValueError,
        ["bonds must be", "some are masked"],
    ),
    "masked species": (
        lambda: md.System(THREE, species=np.ma.masked_equal([1, 2, 1], 2)),
        ValueError,
        ["species must be", "some are masked"],
    ),
    "masked fixed atoms": (
        lambda: md.FixedAtoms(np.ma.masked_equal([0, 1], 1)),
        ValueError,
        ["fixed atoms must be", "some are masked"],
    ),
    "masked lengths": (
        lambda: md.DistanceConstraints([[0, 1], [1, 2]], np.ma.masked_equal([1.0, 2.0], 2.0)),
        ValueError,
        ["lengths must be", "some are masked"],
    ),
    "masked stiffness": (
        lambda: md.HarmonicBond(np.ma.masked_equal([3.0], 3.0), 1.0),
        ValueError,
        ["bond parameters must be", "some are masked"],
    ),
    "complex positions": (lambda: md.System(THREE + 0j), ValueError, ["positions must be", "some are complex"]),
    "complex cell": (lambda: md.Cell.of([9 + 1j, 9, 9]), ValueError, ["cell must be", "some are complex"]),
    "dates in place of positions": (
        lambda: md.System(THREE.astype(int).astype("M8[s]")),
        ValueError,
        ["positions must be", "is not a number"],
    ),
    "numbers as texts": (
        lambda: md.System(THREE.astype(str)),
        ValueError,
        ["positions must be", "'0.0' is not a number"],
    ),
    "bool in place of a mass": (
        lambda: md.System(THREE, masses=True),
        ValueError,
        ["masses must be", "some are bools"],
    ),
    "bool among masses": (
        lambda: md.System(THREE, masses=[True, 2.0, 3.0]),
        ValueError,
        ["masses must be", "some are bools"],
    ),
    "mass beyond all units": (
        lambda: md.System(THREE, masses=1e-300),
        ValueError,
        ["masses must be between 1e-75 and 1e+75", "1e-300"],
    ),
    "text in place of pbc": (
        lambda: md.System(THREE, cell=9, pbc="False"),
        ValueError,
        ["pbc must be one bool or three", "'False'"],
    ),
    "NaN in place of pbc": (
        lambda: md.System(THREE, cell=9, pbc=NAN),
        ValueError,
        ["pbc must be one bool or three", "fractions"],
    ),
    "pbc of two": (
        lambda: md.System(THREE, cell=9, pbc=[True, False]),
        ValueError,
        ["pbc must be one bool or three", "[True, False]"],
    ),
    "pbc of numbers": (
        lambda: md.System(THREE, cell=9, pbc=2),
        ValueError,
        ["pbc must be one bool or three", "pbc = 2"],
    ),
    "cell of lengths too different": (
        lambda: md.Cell.of([1e-5, 1e12, 1.0]),
        ValueError,
        ["lattice vectors", "must not differ by more than"],
    ),
    "positions far from a cell": (
        lambda: simulate(THREE + 1e14, cell=9.0),
        ValueError,
        [
            "positions must be below 4.1e+10 here",
            "1.0e+14",
            "rounding moves atoms by 0.02",
            "the height of the cell, 9",
        ],
    ),
    "positions moved far from a cell": (
        lambda: moved_by(1e14),
        ValueError,
        ["positions must be below 4.1e+10", "the height of the cell, 9"],
    ),
    "positions far for a cutoff": (
        lambda: md.evaluate(md.System(THREE + 1e14), LJ),
        ValueError,
        ["positions must be below", "of a potential, 2.5"],
    ),
    "positions far for a law without cutoff": (
        lambda: md.evaluate(md.System(THREE + 1e14), md.LennardJones(1.0, 1.0)),
        ValueError,
        ["positions must be below 4.5e+09", "the shortest length of a potential, 1"],
    ),
    "positions far for a rigid length": (
        lambda: md.Simulation(md.System(THREE + 1e14), [], md.VelocityVerlet(0.005), md.DistanceConstraints([[0, 1]])),
        ValueError,
        ["positions must be below", "the shortest rigid length"],
    ),
    "rigid length over many cells": (
        lambda: md.Simulation(
            md.System(THREE, cell=3.4), [], md.VelocityVerlet(0.005), md.DistanceConstraints([[0, 1]], 200.0)
        ),
        ValueError,
        [
            "lengths must reach over at most 65536 images",
            "that of constraint 0 is 200 and reaches over 1.8e+06",
            "3.4 high",
        ],
    ),
    "rigid length of astronomy": (
        lambda: md.Simulation(
            md.System(THREE, cell=3.4), [], md.VelocityVerlet(0.005), md.DistanceConstraints([[0, 1]], 1e10)
        ),
        ValueError,
        ["lengths must reach over at most 65536 images", "1e+10"],
    ),
    "loose tolerance": (
        lambda: md.DistanceConstraints([[0, 1]], tolerance=1.0),
        ValueError,
        ["must lie between 0 and 1", "1.0"],
    ),
    "too many unit cells": (
        lambda: md.lattice.crystal("fcc", [10**12] * 3, 1.5),
        ValueError,
        ["repeat must be", "1000000000000"],
    ),
    "too many atoms": (
        lambda: md.lattice.crystal("fcc", [3000] * 3, 1.5),
        ValueError,
        ["at most 134217728 atoms", "makes 1.1e+11"],
    ),
    "half a unit cell": (
        lambda: md.lattice.crystal("fcc", [2, 2, 2.5], 1.5),
        ValueError,
        ["repeat must be three numbers", "fractions"],
    ),
    "as many atoms as fit in eight bytes": (
        lambda: md.System(np.broadcast_to(1.0, (10**12, 3))),
        ValueError,
        ["positions must be", "there are 3000000000000 values, at most 402653184 are allowed"],
    ),
    "as many species as fit in eight bytes": (
        lambda: md.System(THREE, species=np.broadcast_to("Ar", 10**12)),
        ValueError,
        ["species must be 3 labels", "(1000000000000,)"],
    ),
    "neighbors over many images": (
        lambda: md.neighbor_list("ij", md.System(THREE, cell=9.0), 1e6),
        ValueError,
        ["pair lists hold up to"],
    ),
    "no quantities of neighbors": (
        lambda: md.neighbor_list("", md.System(THREE), 1.0),
        ValueError,
        ["quantities must be letters", "''"],
    ),
    "text in place of a flag": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction="no"),
        ValueError,
        ["tail_correction must be True or False", "'no'"],
    ),
    "text in place of overwrite": (
        lambda: simulate(overwrite="no"),
        ValueError,
        ["overwrite must be True or False", "'no'"],
    ),
    "text in place of progress": (
        lambda: md.minimize(md.System(THREE), LJ, progress="no"),
        ValueError,
        ["progress must be True or False", "'no'"],
    ),
    "observers that are no functions": (
        lambda: simulate(observers=[3]),
        TypeError,
        ["observers must be a list of functions", "[3]"],
    ),
    "number in place of a file": (
        lambda: simulate(trajectory=3),
        TypeError,
        ["trajectory must be the path of a file", "3"],
    ),
    "bool in place of threads": (
        lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005), threads=True),
        ValueError,
        ["threads must be a whole number", "True"],
    ),
    "temperature beyond all units": (
        lambda: temperature_set_to(1e300),
        ValueError,
        ["temperature must be", "between 1e-75 and 1e+75", "other units"],
    ),
    "tiny sigma": (
        lambda: md.LennardJones(1.0, 1e-300, 2.5),
        ValueError,
        ["sigma must be positive", "between 1e-75 and 1e+75", "1e-300"],
    ),
    "parameters as texts": (
        lambda: md.PairPotential(coulomb, ("1.0",), 2.5),
        ValueError,
        ["parameters must be", "'1.0' is not a number"],
    ),
    "energy at no distance": (
        lambda: LJ.pair_energy([1.0, 0.0]),
        ValueError,
        ["r must be positive distances", "[1.0, 0.0]"],
    ),
    "shift at infinity": (
        lambda: md.PairPotential(lambda r2, k: (k * r2, -2.0 * k), (1.0,)).pair_energy(1.0),
        ValueError,
        ["the law must be finite at the cutoff, where it is shifted", "give a cutoff, or 'truncated'"],
    ),
    "pairs of a misspelt species": (
        lambda: md.evaluate(md.System(THREE, species=["Ar", "Kr", "Ar"]), with_pairs({("Ar", "Kx"): (3.0, 1.0)})),
        ValueError,
        ["pairs of LennardJones must be of known species, 'Ar', 'Kr'", "they name 'Kx'; did you mean 'Kr'?"],
    ),
    "pairs of numbers for species of texts": (
        lambda: md.evaluate(md.System(THREE, species=["Ar", "Kr", "Ar"]), with_pairs({(1, 2): (3.0, 1.0)})),
        ValueError,
        ["pairs of LennardJones must be of known species", "they name 1"],
    ),
    "pairs beside one set of parameters": (
        lambda: md.PairPotential(coulomb, (1.0,), 2.5, pairs={("Ar", "Kr"): (2.0,)}),
        ValueError,
        ["pairs of PairPotential need parameters that are a mapping from species"],
    ),
    "pairs with too few parameters": (
        lambda: md.PairPotential(coulomb, {"Ar": (1.0,)}, 2.5, pairs={("Ar", "Ar"): ()}),
        ValueError,
        ["all species and pairs must have the same number of parameters"],
    ),
    "pair that is a text": (
        lambda: with_pairs({"ArKr": (1.0, 1.0)}),
        ValueError,
        ["pairs must be a mapping from pairs of species", "ArKr"],
    ),
    "mixing that depends on the order": (
        lambda: md.evaluate(
            md.System(THREE, species=["Ar", "Kr", "Ar"]),
            md.LennardJones({"Ar": (1.0, 1.0), "Kr": (2.0, 1.0)}, cutoff=2.5, mixing=lambda a, b: a),
        ),
        ValueError,
        ["mixing must give", "the same for 'Ar', 'Kr' as for 'Kr', 'Ar'", "(1.0, 1.0) and (2.0, 1.0)"],
    ),
    "mixing without a result": (
        lambda: md.evaluate(
            md.System(THREE, species=["Ar", "Kr", "Ar"]),
            md.LennardJones({"Ar": (1.0, 1.0), "Kr": (2.0, 1.0)}, cutoff=2.5, mixing=lambda a, b: None),
        ),
        ValueError,
        ["Lennard-Jones parameters are (epsilon, sigma)", "('Ar', 'Kr') are None"],
    ),
    "negative cutoff": (
        lambda: md.LennardJones(1.0, 1.0, -2.5),
        ValueError,
        ["cutoff must be positive", "cutoff = -2.5"],
    ),
    "NaN cutoff": (lambda: md.LennardJones(1.0, 1.0, NAN), ValueError, ["cutoff must be positive and finite", "nan"]),
    "no cutoff in a periodic cell": (
        lambda: simulate(potentials=md.LennardJones(1.0, 1.0), cell=10),
        ValueError,
        ["cutoff must be given in a periodic cell", "LennardJones", "None"],
    ),
    "tail correction without a cell": (
        lambda: simulate(potentials=md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction=True)),
        ValueError,
        ["tail_correction needs a density", "periodic"],
    ),
    "tail correction of what has no tail": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, "shifted", tail_correction=True),
        ValueError,
        ["tail_correction needs", "there is no tail with", "'shifted'"],
    ),
    "unknown truncation": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, "shfted"),
        ValueError,
        ["truncation must be one of", "'switched'", "'shfted'"],
    ),
    "unknown mixing rule": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, mixing="mean"),
        ValueError,
        ["mixing must be one of", "'geometric'", "'mean'"],
    ),
    "switch behind the cutoff": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, "switched", switch_start=3.0),
        ValueError,
        ["switch_start", "2.5", "3.0"],
    ),
    "negative epsilon": (
        lambda: md.LennardJones(-1.0, 1.0, 2.5),
        ValueError,
        ["epsilon must be finite and not negative", "-1.0"],
    ),
    "zero sigma": (lambda: md.LennardJones(1.0, 0.0, 2.5), ValueError, ["sigma must be positive and finite", "0.0"]),
    "epsilon without sigma": (lambda: md.LennardJones(1.0), ValueError, ["either epsilon and sigma"]),
    "two factors of three": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 1)),
        ValueError,
        ["bonded_scale must be three", "(0, 1)"],
    ),
    "unknown species": (
        lambda: md.evaluate(md.System(THREE, species=["Ar", "Kr", "Xe"]), TWO_SPECIES),
        ValueError,
        ["no parameters for species 'Xe'", "'Ar', 'Kr'"],
    ),
    "law that is no function": (lambda: md.PairPotential(3.0), TypeError, ["law must be a function", "3.0"]),
    "something that is no potential": (
        lambda: simulate(potentials=[3.0]),
        TypeError,
        ["potentials must be potentials of minimd", "got 3.0"],
    ),
    "name in place of a potential": (
        lambda: simulate(potentials="lennard-jones"),
        TypeError,
        ["potentials must be", "got 'lennard-jones'"],
    ),
    "something that is no method": (
        lambda: md.Simulation(md.System(THREE), LJ, "verlet"),
        TypeError,
        ["method must be an integrator", "VelocityVerlet(0.005)", "'verlet'"],
    ),
    "method without its time step": (
        lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet),
        TypeError,
        ["method must be an integrator"],
    ),
    "negative stiffness": (
        lambda: md.HarmonicBond(-1.0, 1.0),
        ValueError,
        ["k of a harmonic bond must not be negative", "-1.0"],
    ),
    "stiffness of too many bonds": (
        lambda: md.evaluate(md.System(THREE, bonds=[[0, 1]]), md.HarmonicBond([1.0, 2.0], 1.0)),
        ValueError,
        ["bond parameter must be one number or 1", "(2,)"],
    ),
    "angle at a missing atom": (
        lambda: md.evaluate(md.System(THREE), md.HarmonicAngle(1.0, 1.0, [[0, 1, 3]])),
        ValueError,
        ["triples must name atoms 0 to 2", "triples[0] = [0, 1, 3]"],
    ),
    "angle in degrees": (
        lambda: md.HarmonicAngle(1.0, 109.5, [[0, 1, 2]]),
        ValueError,
        ["between 0 and pi (radians)", "109.5"],
    ),
    "zero time step": (
        lambda: md.VelocityVerlet(0.0),
        ValueError,
        ["timestep must be finite and not zero", "timestep = 0.0"],
    ),
    "NaN time step": (
        lambda: md.VelocityVerlet(NAN),
        ValueError,
        ["timestep must be finite and not zero", "timestep = nan"],
    ),
    "time step far too large": (
        lambda: simulate(timestep=5.0, cell=10),
        md.NonFiniteError,
        ["force on atom", "timestep 5 τ too large"],
    ),
    "negative temperature": (
        lambda: temperature_set_to(-1.0),
        ValueError,
        ["temperature must be finite and not negative", "-1.0"],
    ),
    "NaN temperature": (lambda: temperature_set_to(NAN), ValueError, ["temperature must be finite", "nan"]),
    "negative skin": (
        lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005), skin=-0.1),
        ValueError,
        ["skin", "-0.1"],
    ),
    "negative number of steps": (
        lambda: simulate(n_steps=-1),
        ValueError,
        ["n_steps must be a whole number", "n_steps = -1"],
    ),
    "half a step": (lambda: simulate(n_steps=0.5), ValueError, ["n_steps must be a whole number", "0.5"]),
    "observed every 0 steps": (
        lambda: simulate(every=0),
        ValueError,
        ["every must be a whole number, at least 1", "every = 0"],
    ),
    "report before a run": (
        lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005)).report(),
        ValueError,
        ["call run first"],
    ),
    "unknown suffix": (
        lambda: simulate(trajectory="run.pdf"),
        ValueError,
        ["suffix of a trajectory must be one of .h5md", "'run.pdf'"],
    ),
    "output in a missing folder": (
        lambda: simulate(trajectory="/no/such/folder/a.h5md"),
        FileNotFoundError,
        ["'/no/such/folder' does not exist"],
    ),
    "something that is no system": (
        lambda: md.Simulation("argon", LJ, md.VelocityVerlet(0.005)),
        TypeError,
        ["System or an ase.Atoms", "got str"],
    ),
}


@pytest.mark.parametrize("wrong", WRONG_CALLS)
def test_wrong_call_is_answered_with_one_sentence(wrong):
    call, kind, words = WRONG_CALLS[wrong]
    with pytest.raises(kind) as caught:
        call()
    message = str(caught.value)
    assert type(caught.value) is kind
    assert message.count("\n") <= (kind in (md.NonFiniteError, md.ConstraintError)), (
        "one sentence; of a failed run the cause, and what was seen"
    )
    assert [word for word in words if word not in message] == [], message
    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    assert "minimd" in Path(last.filename).parts, "the error comes from the inside of another library"
    assert last.line.startswith("raise"), "the error was not foreseen"


def test_a_library_of_pairs_may_know_more_species_than_the_system():
    library = {"Ar": (1.0, 1.0), "Kr": (2.0, 1.1), "Xe": (3.0, 1.2)}
    system = md.System(THREE, species=["Ar", "Kr", "Ar"])
    small = md.evaluate(
        system, md.LennardJones({name: library[name] for name in ("Ar", "Kr")}, cutoff=2.5)
    ).potential_energy
    assert (
        md.evaluate(system, md.LennardJones(library, cutoff=2.5, pairs={("Kr", "Xe"): (9.0, 1.0)})).potential_energy
        == small
    )
    complete = {(a, b): (1.0, 1.0) for a in library for b in library}
    assert (
        md.evaluate(system, md.LennardJones({}, cutoff=2.5, pairs=complete)).potential_energy
        == md.evaluate(system, LJ).potential_energy
    )


def test_arrays_of_any_kind_of_real_numbers_are_taken():
    for kind in (np.float16, np.float32, np.float64, np.longdouble, np.int8, np.uint64, object):
        taken = md.System(
            (10 * THREE).astype(kind),
            masses=np.array([1, 2, 3]).astype(kind),
            cell=np.array([30, 40, 50]).astype(kind),
            pbc=[1, 1, 0],
        )
        assert taken.positions.tolist() == (10 * THREE).tolist()
        assert (taken.masses.tolist(), taken.cell.vectors.diagonal().tolist(), taken.cell.pbc.tolist()) == (
            [1, 2, 3],
            [30, 40, 50],
            [True, True, False],
        )
    assert md.FixedAtoms(np.array([2, 0], dtype=np.uint64)).atoms.tolist() == [0, 2]
    md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005), md.FixedAtoms(np.array([0], dtype=np.uint64)))
    assert md.System(np.ma.array(THREE)).positions.tolist() == THREE.tolist()  # nothing is masked


def test_numbers_in_single_precision_are_those_they_stand_for(recwarn):
    single = md.LennardJones(np.float32(1.0), np.float32(1.0), np.float32(2.5))
    assert md.evaluate(md.System(THREE), single).potential_energy == md.evaluate(md.System(THREE), LJ).potential_energy
    assert not recwarn.list


def test_existing_output_is_refused_and_kept(tmp_path):
    (tmp_path / "a.h5md").write_text("precious")
    with pytest.raises(FileExistsError, match=r"a\.h5md' exists; choose another name, or pass overwrite=True"):
        simulate(trajectory=tmp_path / "a.h5md")
    assert (tmp_path / "a.h5md").read_text() == "precious"


def test_full_disk_ends_a_run_with_a_sentence_and_a_valid_file(tmp_path, monkeypatch):
    fill_the_disk(monkeypatch, after=5)
    with pytest.raises(
        OSError, match=r"a\.h5md' could not take the frame of step 2: No space left on device; the 2 frames"
    ) as caught:
        simulate(every=1, trajectory=tmp_path / "a.h5md")
    assert "\n" not in str(caught.value)
    assert read_file(tmp_path / "a.h5md").record.step.tolist() == [0, 1]
