"""Systems side by side: every method on the same recordings, with quality, calibration and cost."""

from .denoising import Denoising
from .harness import Answer, measure
from .measured import Captures, Measured, names_of, read_captures
from .measured_report import judged_capture, left_over, measured_table, model_table
from .phase_report import aligned, judged_phases, phase_table, protocol_notes, variance_picture
from .phase_retrieval import PhaseRetrieval, pictures_of
from .phase_systems import PHASE_SYSTEMS
from .pictures import held_out
from .report import as_table, judged, picture
from .systems import SYSTEMS

__all__ = [
    "PHASE_SYSTEMS",
    "PhaseRetrieval",
    "aligned",
    "judged_phases",
    "phase_table",
    "pictures_of",
    "protocol_notes",
    "variance_picture",
    "SYSTEMS",
    "Answer",
    "Captures",
    "Denoising",
    "Measured",
    "as_table",
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
