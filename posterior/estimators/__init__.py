"""Estimators: single answers, to compare with and to start from."""

from .anscombe import anscombe, anscombe_denoised, exact_unbiased_inverse
from .calibration import Calibrated, Calibration, calibrate
from .half_samples import half_samples
from .hio import Retrieved, hio
from .mmse import mmse
from .photon_transfer import PhotonTransfer, photon_transfer
from .pnp_admm import Plugged, plug_and_play_admm
from .prdeep import prdeep
from .prgamp import Passed, prgamp
from .quasi_newton import Optimum, default_start, maximum_likelihood, maximum_posterior
from .red import Regularised, red
