"""Kicks, drifts and the methods composed from them; implicit methods, differential-algebraic equations and invariants
of small systems."""

from minimd.integrators.dae.hessenberg import *
from minimd.integrators.dae.implicit import *
from minimd.integrators.manifold.holonomic import *
from minimd.integrators.manifold.invariants import *
from minimd.integrators.method import *
from minimd.integrators.methods import *
from minimd.integrators.ode.bdf import *
from minimd.integrators.ode.drivers import *
from minimd.integrators.ode.newton import *
from minimd.integrators.ode.problems import *
from minimd.integrators.ode.runge_kutta import *
from minimd.integrators.splitting.barostats import *
from minimd.integrators.splitting.order_conditions import *
from minimd.integrators.splitting.rows import *
from minimd.integrators.splitting.splitting import *
from minimd.integrators.splitting.state import *
from minimd.integrators.splitting.substeps import *
from minimd.integrators.splitting.thermostats import *
