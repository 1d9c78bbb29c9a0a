"""Samplers: one file each, all with init(key, posterior) and step(key, state)."""

from .annealed import AnnealedLangevin
from .base import Sampler
from .blackjax import BlackJAX
from .daps import DAPS
from .dps import DPS
from .ensemble import Ensemble
from .kawar import Kawar
from .mala import MALA
from .smc import TemperedSMC
from .snips import SNIPS
from .split_gibbs import SplitGibbs
from .thickening import Thickening
from .ula import ULA
