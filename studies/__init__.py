"""Systems side by side: every method on the same recordings, with quality, calibration and cost."""

from .approximations import Approximations, OnPictures
from .approximations_plot import cost_picture
from .approximations_report import cost_table, costs
from .denoising import Denoising
from .harness import Answer, measure
from .measured import Captures, Measured, names_of, read_captures
from .measured_report import judged_capture, left_over, measured_table, model_table
from .pictures import held_out
from .report import as_table, judged, picture
from .systems import SYSTEMS

__all__ = [
    "SYSTEMS",
    "Answer",
    "Approximations",
    "Captures",
    "Denoising",
    "Measured",
    "OnPictures",
    "as_table",
    "cost_picture",
    "cost_table",
    "costs",
    "held_out",
    "judged",
    "judged_capture",
    "left_over",
    "measure",
    "measured_table",
    "model_table",
    "names_of",
    "picture",
    "read_captures",
]
