"""What is known before the data: the physics of the recording, and priors on the object.

`Gaussian` here is the camera; the prior of that name is `priors.Gaussian`, or `GaussianPrior`.
"""

from . import annealing, camera, gallery, likelihood, optics, priors
from .camera import Camera, Gaussian, Poisson, PoissonGaussian
from .exposures import Exposures
from .likelihood import IntensityLikelihood, Likelihood, LinearLikelihood
from .optics import (
    Blur,
    CodedDiffraction,
    Fourier,
    FourierPtychography,
    Identity,
    Matrix,
    Optics,
    Propagation,
)
from .priors import (
    EnergyPrior,
    FlatPrior,
    GaussianField,
    GaussianMixture,
    PixelPrior,
    Prior,
    ScorePrior,
)
from .priors import Gaussian as GaussianPrior
