"""Systems side by side: every method on the same recordings, with quality, calibration and cost."""

from .approximations import Approximations, OnPictures
from .approximations_plot import cost_picture
from .approximations_report import cost_table, costs
from .denoising import Denoising
from .harness import Answer, measure
from .measured import Captures, Measured, left_halves_of, names_of, read_captures
from .measured_report import judged_capture, left_over, measured_report, measured_table
from .phase_report import aligned, judged_phases, phase_table, protocol_notes, variance_picture
from .phase_retrieval import PhaseRetrieval, pictures_of
from .phase_systems import PHASE_SYSTEMS
from .pictures import held_out
from .ptychography import Condition, Ptychography
from .ptychography_report import Judged, judged_objects, ptychography_table
from .ptychography_systems import PTYCHOGRAPHY_SYSTEMS
from .report import as_table, judged, picture
from .specimens import specimens
from .stack_halves import StackHalves, stack_table
from .systems import SYSTEMS

__all__ = [
    "PHASE_SYSTEMS",
    "PTYCHOGRAPHY_SYSTEMS",
    "SYSTEMS",
    "Answer",
    "Approximations",
    "Captures",
    "Condition",
    "Denoising",
    "Judged",
    "Measured",
    "OnPictures",
    "PhaseRetrieval",
    "Ptychography",
    "StackHalves",
    "aligned",
    "as_table",
    "cost_picture",
    "cost_table",
    "costs",
    "held_out",
    "judged",
    "judged_capture",
    "judged_objects",
    "judged_phases",
    "left_halves_of",
    "left_over",
    "measure",
    "measured_report",
    "measured_table",
    "names_of",
    "phase_table",
    "picture",
    "pictures_of",
    "protocol_notes",
    "ptychography_table",
    "read_captures",
    "specimens",
    "stack_table",
    "variance_picture",
]
