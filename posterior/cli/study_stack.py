"""The measured part of `posterior study ptychography`: half of a stack predicts the other."""

import hashlib
from pathlib import Path

from ..files import replace_whole
from ..models.priors.storage import card_of
from ..studies.harness import Answer, measure
from ..studies.stack_halves import CONDITION, StackHalves, stack_table
from ..studies.stack_plot import prediction


def run_stack(
    stack: Path, out: Path, prior: str, systems: list[str], view: int, widest: float, draws: int,
    seed: int, background: bool, quiet: bool,
) -> None:  # fmt: skip
    """Writes stack.md and stack.png into `out`.

    Answers are kept, the calibration is found again each time.
    """
    identity = {
        "study": "stack", "stack": hashlib.sha256(stack.read_bytes()).hexdigest(),
        "weights": card_of(prior)["sha256"], "view": view, "widest": widest, "draws": draws,
        "seed": seed, "background": background,
    }  # fmt: skip
    study = StackHalves.of(
        stack, view, widest, prior, draws, seed, progress=not quiet, background=background
    )
    answers: dict[str, Answer] = {}
    for name, _, _, answer in measure(out / "answers", identity, systems, [CONDITION], 1, study):
        if answer is not None:
            answers[name] = answer
            text = stack_table(study, answers)
            replace_whole(
                out / "stack.md", lambda p, text=text: Path(p).write_text(text, encoding="utf-8")
            )
    if given := {name: answer for name, answer in answers.items() if not answer.refusal}:
        figure = prediction(study, given)
        replace_whole(out / "stack.png", lambda p: figure.savefig(p, dpi=130, format="png"))
    print((out / "stack.md").read_text(encoding="utf-8"), end="")
