"""Priors: what is believed about the object before the data."""

from .base import Prior
from .embedded import RealAmongComplex
from .field import GaussianField
from .flat import FlatPrior
from .gaussian import Gaussian
from .learned import EnergyPrior, ScorePrior
from .mixture import GaussianMixture
from .pixel import PixelPrior
