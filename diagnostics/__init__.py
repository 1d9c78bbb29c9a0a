"""Can the draws be believed? These functions see arrays, a Problem and a sampler."""

from .convergence import ess, mcse, rhat
from .distance import noise_floor, sliced_wasserstein
from .gauge import Gauge, align, gauge_to
from .modes import Modes, modes
from .predictive import misfit
from .spread import circular_mean, circular_sd, interval, interval_width, spread_over_error
