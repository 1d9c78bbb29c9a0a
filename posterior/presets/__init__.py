"""Three applications, ready to ask: denoising, phase retrieval, Fourier ptychography.

Each takes a picture of the object, which a simulated camera records, or a recording, and gives the
`Problem`, the data and, if it is known, the truth. The prior is a Gaussian field fitted to pictures
of other things, or a network that was trained on them.
"""

from .applications import (
    APPLICATIONS,
    DENOISING,
    PHASE_RETRIEVAL,
    PTYCHOGRAPHY,
    Application,
    Question,
)
from .colour import COLOURS
from .exposure import prior_scale
from .objects import complex_object
from .optics import LEDS, aperture_grid
from .prior import (
    PRIOR_PICTURES,
    best_sampler,
    denoising_sampler,
    is_shipped,
    is_trained,
    scout_of,
    weights_card,
    whole_path,
)
from .questions import measured, record, simulate
from .recordings import picture_of
from .samplers import SAMPLERS, STARTS, Sampling, learned_annealing, sampler_of, start_of
