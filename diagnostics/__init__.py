"""Can the draws be believed? These functions see arrays, a Problem and a sampler."""

from .campaign import Settings, Simulations, simulate
from .certificate import Certificate, certify
from .conformal import Repair, repair_intervals, widened
from .convergence import ess, mcse, rhat
from .coverage import Coverage, coverage
from .distance import noise_floor, sliced_wasserstein
from .fidelity import crps, energy_score, frechet_distance, nrmse, phase_psnr, psnr, ssim
from .gauge import Gauge, align, gauge_to
from .modes import Modes, modes
from .predictive import misfit, predicted, predictive_ranks
from .quantities import default_quantities
from .rank_plot import plot_ranks
from .ranks import randomised_ranks, thinned
from .sbc import Calibration, sbc
from .spread import circular_mean, circular_sd, interval, interval_width, spread_over_error
from .uniformity import bands, holm, uniformity
