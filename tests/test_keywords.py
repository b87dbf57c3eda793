"""A misspelt keyword is answered with the one that was meant, and nothing else changes."""

import inspect
import pickle
import sys

import pytest
from references import liquid

import minimd as md
from minimd.structure import keywords

LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")


def simulation(**options):
    return md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002), **options)


MISSPELT = {
    "observers": lambda: simulation().run(1, observer=[]),
    "sigma": lambda: md.LennardJones(sigm=1.0),
    "timestep": lambda: md.PositionVerlet(time_step=0.1),
    "seed": lambda: md.LangevinBAOAB(0.1, 1.0, 1.0, seeds=1),
    "bonds": lambda: md.System([[0.0, 0.0, 0.0]], bond=[]),
    "threads": lambda: md.Simulation.resume("run.h5md", LJ, thread=1),
    "angles": lambda: md.System.from_ase(None, angle=[]),
    "potentials": lambda: md.evaluate(liquid(3), potential=LJ),
    "max_steps": lambda: md.minimize(liquid(3), LJ, max_step=10),
    "lattice_constant": lambda: md.lattice.crystal("fcc", [1, 1, 1], constant=1.0),
    "r_max": lambda: md.observers.RadialDistribution(rmax=2.0),
}


@pytest.mark.parametrize("meant", MISSPELT)
def test_the_keyword_that_was_meant_is_named(meant):
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '\w+'(; d|\. D)id you mean '{meant}'\?$"):
        MISSPELT[meant]()


@pytest.mark.parametrize(("given", "known"), [("store_force", "store_forces"), ("trajectory", "trajectory")])
def test_a_keyword_of_the_run_is_found_where_it_belongs(given, known):
    with pytest.raises(TypeError, match=rf"'{given}'; '{known}' is a keyword of Simulation.run$"):
        simulation(**{given: True})


def test_charges_are_answered_with_what_minimd_has_not():
    with pytest.raises(TypeError, match=r"'charges'; minimd has no electrostatics"):
        md.System([[0.0, 0.0, 0.0]], charges=[1.0])


def test_a_keyword_like_no_other_is_told_as_python_does():
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'zzz'$"):
        simulation(zzz=1)


def test_what_is_raised_inside_a_call_stays_as_it_is():
    def looks(_simulation):
        raise TypeError("draw() got an unexpected keyword argument 'observer'")

    with pytest.raises(TypeError) as caught:
        simulation().run(1, observers=[looks])
    assert str(caught.value) == "draw() got an unexpected keyword argument 'observer'"


def test_a_traceback_has_no_line_about_it():
    for fails in (lambda: simulation().run(-1), lambda: simulation().run(1, observer=[]), md.System):
        with pytest.raises((ValueError, TypeError)) as caught:
            fails()
        assert keywords.__file__ not in {str(entry.path) for entry in caught.traceback}


def test_signatures_names_and_help_are_those_of_the_functions():
    assert list(inspect.signature(md.LennardJones).parameters)[:3] == ["epsilon", "sigma", "cutoff"]
    assert inspect.signature(md.Simulation.run).parameters["every"].default == 100
    assert md.Simulation.run.__qualname__ == "Simulation.run"
    assert md.Simulation.resume.__doc__.startswith("The simulation at the restart")
    assert inspect.getsource(md.evaluate).partition("def ")[2].startswith("evaluate(")


def test_functions_and_methods_can_be_pickled():
    run = simulation().run
    for one in (
        md.evaluate,
        md.ensemble,
        md.replay,
        md.Simulation.run,
        md.Simulation.resume,
        md.lattice.crystal,
        LJ,
        run,
    ):
        again = pickle.loads(pickle.dumps(one))
        assert again is one or one in (LJ, run, md.Simulation.resume)


def test_no_step_passes_through_it():
    """However many steps a run makes, the calls that are watched for keywords are as many."""

    def calls(n_steps):
        seen, made = [], simulation()
        sys.setprofile(
            lambda frame, event, _: (
                seen.append(1) if event == "call" and frame.f_code.co_filename == keywords.__file__ else None
            )
        )
        try:
            made.run(n_steps, every=1000)
        finally:
            sys.setprofile(None)
        return len(seen)

    assert 0 < calls(10) == calls(60)
