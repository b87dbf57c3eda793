"""A misspelt keyword is answered with the one that was meant, and nothing else changes."""

import inspect
import pickle
import sys

import pytest
from references import liquid

import minimd as md
from minimd.structure import keywords

LJ, LIQUID, VERLET = md.LennardJones(1.0, 1.0, 1.8, "force-shifted"), liquid(2), md.VelocityVerlet(0.002)


def simulation(**options):
    return md.Simulation(LIQUID, LJ, VERLET, **options)


MISSPELT = {  # the keyword that was meant
    "observers": lambda: simulation().run(1, observer=[]),
    "timestep": lambda: md.PositionVerlet(time_step=0.1),
    "bonds": lambda: md.System([[0.0, 0.0, 0.0]], bond=[]),
    "threads": lambda: md.Simulation.resume("run.h5md", LJ, thread=1),
    "potentials": lambda: md.evaluate(LIQUID, potential=LJ),
    "lattice_constant": lambda: md.lattice.crystal("fcc", [1, 1, 1], constant=1.0),
    "store_forces' is a keyword of Simulation.run": lambda: simulation(store_force=True),
    "zzz": lambda: simulation(zzz=1),
}


def test_the_keyword_that_was_meant_is_named():
    for meant, call in MISSPELT.items():
        with pytest.raises(TypeError, match=r"unexpected keyword argument '\w+'") as caught:
            call()
        assert f"'{meant}" in str(caught.value)
    with pytest.raises(TypeError, match=r"'charges'; minimd has no electrostatics"):
        md.System([[0.0, 0.0, 0.0]], charges=[1.0])


def test_what_is_raised_inside_a_call_stays_as_it_is_and_no_traceback_has_a_line_about_it():
    def looks(_simulation):
        raise TypeError("draw() got an unexpected keyword argument 'observer'")

    with pytest.raises(TypeError) as caught:
        simulation().run(1, observers=[looks])
    assert str(caught.value) == "draw() got an unexpected keyword argument 'observer'"
    for fails in (lambda: simulation().run(-1), lambda: simulation().run(1, observer=[]), md.System):
        with pytest.raises((ValueError, TypeError)) as caught:
            fails()
        assert keywords.__file__ not in {str(entry.path) for entry in caught.traceback}


def test_signatures_and_pickles_are_those_of_the_functions():
    assert list(inspect.signature(md.LennardJones).parameters)[:3] == ["epsilon", "sigma", "cutoff"]
    assert all(pickle.loads(pickle.dumps(one)) is one for one in (md.evaluate, md.Simulation.run, md.lattice.crystal))


def test_no_step_passes_through_it():
    """As many calls are watched for keywords in a long run as in a short one."""
    watched = []
    for n_steps in (10, 60):
        seen, made = [], simulation()
        sys.setprofile(lambda frame, event, _, seen=seen: seen.append(frame.f_code.co_filename))
        try:
            made.run(n_steps, every=1000)
        finally:
            sys.setprofile(None)
        watched.append(seen.count(keywords.__file__))
    assert 0 < watched[0] == watched[1]
