"""Can the draws be believed? These functions see arrays, a Problem and a sampler."""

from .campaign import OutOfTime, Settings, Simulations, simulate
from .certificate import Certificate, certify
from .certificate_page import as_page
from .certificate_plot import plot_certificates
from .certificate_table import as_matrix, as_table
from .chain_plot import plot_chains
from .component_plot import plot_components, plot_contrast
from .components import Components, Contrast, contrast, principal_components
from .conformal import Repair, repair_intervals, widened
from .convergence import ess, mcse, nested_rhat, rhat
from .coverage import Coverage, coverage
from .coverage_plot import plot_coverage
from .distance import (
    Distance,
    beside_floor,
    c2st,
    mmd,
    noise_floor,
    sliced_wasserstein,
    two_sample_p,
)
from .distance_plot import plot_distances, plot_frechet
from .features import HAAR, Features, bottleneck_features, haar_bands
from .fidelity import crps, energy_score, frechet_distance, nrmse, phase_psnr, psnr, ssim
from .frechet import Frechet, frechet_from_truths, frechet_of_halves
from .gauge import Gauge, align, gauge_to, symmetries_of
from .joint import JointTest, geweke
from .longer_exposure import Exposures, longer_exposure
from .map_plot import plot_crps, plot_ess, plot_residuals, plot_rhat
from .mode_masses import mode_masses
from .mode_plot import plot_mode_masses
from .modes import Modes, modes
from .pit_plot import plot_pit
from .plots import ComplexMaps, complex_maps, overview
from .posterior_sbc import posterior_sbc
from .predictive import (
    misfit,
    normalised_residuals,
    predicted,
    predictive_ranks,
    reduced_chi_square,
)
from .quantities import DistanceToAmplitudes, default_quantities
from .rank_plot import plot_ranks
from .ranks import randomised_ranks, thinned
from .reliability import Reliability, reliability
from .reliability_plot import plot_reliability
from .repair_plot import plot_repair
from .residuals import Check, Residuals, residual_checks
from .sbc import Calibration, sbc
from .score_count import score_evaluations
from .shared_errors import shared_errors
from .spread import (
    circular_mean,
    circular_sd,
    interval,
    interval_width,
    quantile,
    spread_over_error,
)
from .stein import ksd, ksd_beside_floor
from .streaming import StreamingQuantiles
from .uniformity import bands, holm, uniformity
