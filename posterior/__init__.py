"""posterior: draw the posterior of an imaging problem, and prove that its uncertainty is true."""

from . import diagnostics, estimators, models, samplers, stacks
from .draws import Draws, load
from .problem import Posterior, Problem
from .sampling import NonFiniteError, sample
