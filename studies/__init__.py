"""Systems side by side: every method on the same recordings, with quality, calibration and cost."""

from .denoising import SYSTEMS, Denoising
from .harness import Answer, measure
from .pictures import held_out
from .report import as_table, judged, picture

__all__ = ["SYSTEMS", "Answer", "Denoising", "as_table", "held_out", "judged", "measure", "picture"]
