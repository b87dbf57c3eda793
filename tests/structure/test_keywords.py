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


MISSPELT = {  # how the answer ends
    "did you mean 'observers'?": lambda: simulation().run(1, observer=[]),
    "did you mean 'sigma'?": lambda: md.LennardJones(sigm=1.0),
    "did you mean 'timestep'?": lambda: md.PositionVerlet(time_step=0.1),
    "did you mean 'seed'?": lambda: md.LangevinBAOAB(0.1, 1.0, 1.0, seeds=1),
    "did you mean 'bonds'?": lambda: md.System([[0.0, 0.0, 0.0]], bond=[]),
    "did you mean 'threads'?": lambda: md.Simulation.resume("run.h5md", LJ, thread=1),
    "did you mean 'angles'?": lambda: md.System.from_ase(None, angle=[]),
    "did you mean 'potentials'?": lambda: md.evaluate(LIQUID, potential=LJ),
    "did you mean 'max_steps'?": lambda: md.minimize(LIQUID, LJ, max_step=10),
    "did you mean 'lattice_constant'?": lambda: md.lattice.crystal("fcc", [1, 1, 1], constant=1.0),
    "did you mean 'r_max'?": lambda: md.observers.RadialDistribution(rmax=2.0),
    "'store_forces' is a keyword of Simulation.run": lambda: simulation(store_force=True),
    "'trajectory' is a keyword of Simulation.run": lambda: simulation(trajectory=True),
    "unexpected keyword argument 'zzz'": lambda: simulation(zzz=1),
}


def looks(_simulation):
    raise TypeError("draw() got an unexpected keyword argument 'observer'")


def calls(n_steps):
    """How many calls are watched for keywords while a run makes some steps."""
    seen, made = [], simulation()
    sys.setprofile(lambda frame, event, _: seen.append(frame.f_code.co_filename) if event == "call" else None)
    try:
        made.run(n_steps, every=1000)
    finally:
        sys.setprofile(None)
    return seen.count(keywords.__file__)


def test_the_keyword_that_was_meant_is_named():
    for end, call in MISSPELT.items():
        with pytest.raises(TypeError, match=r"unexpected keyword argument '\w+'") as caught:
            call()
        assert str(caught.value).lower().endswith(end.lower())  # Python 3.13 says it itself
    with pytest.raises(TypeError, match=r"'charges'; minimd has no electrostatics"):
        md.System([[0.0, 0.0, 0.0]], charges=[1.0])


def test_what_is_raised_inside_a_call_stays_as_it_is():
    with pytest.raises(TypeError) as caught:
        simulation().run(1, observers=[looks])
    assert str(caught.value) == "draw() got an unexpected keyword argument 'observer'"


def test_a_traceback_has_no_line_about_it():
    for fails in (lambda: simulation().run(-1), lambda: simulation().run(1, observer=[]), md.System):
        with pytest.raises((ValueError, TypeError)) as caught:
            fails()
        assert keywords.__file__ not in {str(entry.path) for entry in caught.traceback}


def test_signatures_names_help_and_pickles_are_those_of_the_functions():
    assert list(inspect.signature(md.LennardJones).parameters)[:3] == ["epsilon", "sigma", "cutoff"]
    assert inspect.signature(md.Simulation.run).parameters["every"].default == 100
    assert md.Simulation.run.__qualname__ == "Simulation.run"
    assert md.Simulation.resume.__doc__.startswith("The simulation at the restart")
    assert inspect.getsource(md.evaluate).partition("def ")[2].startswith("evaluate(")
    for one in (md.evaluate, md.ensemble, md.replay, md.Simulation.run, md.lattice.crystal):
        assert pickle.loads(pickle.dumps(one)) is one
    for one in (LJ, simulation().run, md.Simulation.resume):
        assert type(pickle.loads(pickle.dumps(one))) is type(one)


def test_no_step_passes_through_it():
    assert 0 < calls(10) == calls(60)
