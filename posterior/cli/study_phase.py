"""`posterior study phase-retrieval`: the systems of the paper's Table 2 on the same recordings."""

import hashlib
from pathlib import Path
from typing import Annotated

import typer
from matplotlib.figure import Figure

from ..files import replace_whole
from ..models.priors.storage import card_of
from ..presets import scout_of
from ..studies import (
    PHASE_SYSTEMS,
    Answer,
    PhaseRetrieval,
    aligned,
    judged_phases,
    measure,
    phase_table,
    picture,
    pictures_of,
    protocol_notes,
    variance_picture,
)
from ..studies.phase_retrieval import DEFINITIONS, Condition, check_alpha
from .options import Quiet, asked_of, study_data

_ALPHAS = ("2", "3", "4")

# What the study found so far: answers of its systems, by condition.
Found = dict[str, dict[str, Answer]]


def command(
    data: Annotated[
        Path,
        typer.Option(
            help="An .npz file with images_float in grey levels (prdeep_natural6.npz), to test on; "
            "or the folder of the prior's validation pictures, to choose settings on."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the answers, tables and pictures.")],
    prior: Annotated[
        str, typer.Option(help="Shipped weights, or paths up to -gaussian-score.safetensors.")
    ] = "natural",
    scout: Annotated[
        str | None,
        typer.Option(help="Weights whose denoiser finds the starts; unsaid: of NAME-large NAME."),
    ] = None,
    alpha: Annotated[
        list[str], typer.Option(help="Noise level as prDeep counts it; may be repeated.")
    ] = list(_ALPHAS),  # noqa: B006
    definition: Annotated[
        list[str],
        typer.Option(
            help=f"Of the noise: {', '.join(DEFINITIONS)} (true counts behind so many bits); may "
            "be repeated."
        ),
    ] = list(DEFINITIONS),  # noqa: B006
    system: Annotated[
        list[str] | None,
        typer.Option("--system", help=f"One of {'; '.join(PHASE_SYSTEMS)}; unsaid: all."),
    ] = None,
    pictures: Annotated[int | None, typer.Option(help="The first so many; unsaid: all.")] = None,
    draws: Annotated[int, typer.Option(help="Of each system that samples, 2 or more.")] = 8,
    seeds: Annotated[int, typer.Option(help="Recordings of each picture.")] = 1,
    seed: Annotated[int, typer.Option(help="Same seed, same recordings and draws.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Pictures behind the magnitudes of their Fourier transform, by every system of Table 2."""
    names = asked_of("system", system, PHASE_SYSTEMS)
    for value in alpha:
        check_alpha(value)
    conditions = [f"{value}-{kind}" for kind in definition for value in alpha]
    for condition in conditions:
        Condition.of(condition)
    scout = scout or scout_of(prior)
    weights, found_by = card_of(prior)["sha256"], card_of(scout)["sha256"]
    if draws < 2 or seeds < 1 or seed < 0 or (pictures is not None and pictures < 1):
        raise ValueError(
            f"--pictures {pictures}, --draws {draws}, --seeds {seeds}, --seed {seed}: give draws "
            "of 2 or more, pictures and seeds of 1 or more, a seed of 0 or more"
        )
    truths = pictures_of(study_data(data), prior, pictures)
    count = len(truths) * seeds
    if count < 2:
        raise ValueError("one answer has no spread: give 2 pictures or seeds, or more")
    work = PhaseRetrieval(truths, prior, draws, seed, scout)
    for condition in conditions:
        work.recording(condition, 0)
    identity = {
        "study": "phase-retrieval", "weights": weights, "draws": draws, "seed": seed,
        "pictures": hashlib.sha256(truths.tobytes()).hexdigest(),
    }  # fmt: skip
    if found_by != weights:
        identity["scout"] = found_by
    results = _Results(out, work, names)
    for name, condition, done, answer in measure(
        out / "answers", identity, names, conditions, count, work
    ):
        if answer is not None:
            results.add(condition, name, answer)
        elif not quiet:
            print(f"{condition}, {name}: {done} of {count}", flush=True)
    print((out / "study.md").read_text(encoding="utf-8"), end="")


class _Results:
    """Tables and pictures of the answers so far, written anew with every one."""

    def __init__(self, out: Path, work: PhaseRetrieval, systems: list[str]):
        self.out, self.work, self.systems = out, work, systems
        self.found: Found = {}
        self.aligned: Found = {}
        self.judged: dict[str, dict[str, dict]] = {}
        self.tables: dict[str, str] = {}

    def add(self, condition: str, system: str, answer: Answer) -> None:
        answers = self.found.setdefault(condition, {})
        answers[system] = answer
        shown = answer if answer.refusal else answer._replace(images=aligned(self.work, answer))
        self.aligned.setdefault(condition, {})[system] = shown
        judged = self.judged.setdefault(condition, {})
        if not answer.refusal:
            judged[system] = judged_phases(self.work, condition, answer)
        self.tables[condition] = phase_table(self.work, condition, judged, answers)
        self._write()

    def _write(self) -> None:
        text = "\n".join([*self.tables.values(), protocol_notes(self.systems)])
        replace_whole(self.out / "study.md", lambda p: Path(p).write_text(text, encoding="utf-8"))
        truth = self.work.truth(0)
        self._save("study.png", picture(self.aligned, dict.fromkeys(self.aligned, truth)))
        sampled = variance_picture(self.aligned, truth)
        if sampled is not None:
            self._save("variance.png", sampled)

    def _save(self, name: str, figure: Figure) -> None:
        replace_whole(self.out / name, lambda p: figure.savefig(p, dpi=150, format="png"))
