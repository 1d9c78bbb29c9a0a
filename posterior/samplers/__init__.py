"""Samplers: one file each, all with init(key, posterior) and step(key, state)."""

from .annealed import AnnealedLangevin
from .base import Sampler
from .blackjax import BlackJAX
from .ensemble import Ensemble
from .mala import MALA
from .smc import TemperedSMC
from .ula import ULA
