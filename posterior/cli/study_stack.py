"""The measured part of `posterior study ptychography`: half of a stack predicts the other."""

import hashlib
from pathlib import Path

from ..files import replace_whole
from ..models.priors.storage import card_of
from ..studies.harness import Answer, measure
from ..studies.stack_halves import CONDITION, StackHalves, stack_table


def run_stack(
    stack: Path, out: Path, prior: str, systems: list[str], view: int, widest: float, draws: int,
    seed: int, quiet: bool,
) -> None:  # fmt: skip
    """Writes stack.md into `out`; answers are kept, the calibration is found again each time."""
    identity = {
        "study": "stack", "stack": hashlib.sha256(stack.read_bytes()).hexdigest(),
        "weights": card_of(prior)["sha256"], "view": view, "widest": widest, "draws": draws,
        "seed": seed,
    }  # fmt: skip
    study = StackHalves.of(stack, view, widest, prior, draws, seed, progress=not quiet)
    answers: dict[str, Answer] = {}
    for name, _, _, answer in measure(out / "answers", identity, systems, [CONDITION], 1, study):
        if answer is not None:
            answers[name] = answer
            text = stack_table(study, answers)
            replace_whole(
                out / "stack.md", lambda p, text=text: Path(p).write_text(text, encoding="utf-8")
            )
    print((out / "stack.md").read_text(encoding="utf-8"), end="")
