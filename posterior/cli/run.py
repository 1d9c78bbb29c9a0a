"""A run from beginning to end: the question, its draws, what they say, and the results written."""

import dataclasses
import hashlib
import os
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import typer

from .. import presets
from ..draws import Draws, versions
from ..images import read_picture, split_key
from ..models.camera import Poisson
from ..models.priors import ScorePrior
from ..presets import SAMPLERS, Question
from ..problem import Posterior
from ..samplers import Sampler
from ..sampling import sample
from ..stacks import read_stack
from .options import Options
from .outputs import CHECKPOINT, prepare, write
from .summary import summarise
from .words import doubts, out_of_range, tell


def run(
    options: Options,
    out: Path,
    overwrite: bool = False,
    quiet: bool = False,
    earlier: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Sample, write the results to `out`, say what was found; returns the settings written.

    A run that was killed goes on from its checkpoint. With `earlier`, settings of a finished run,
    it refuses an input or a prior that has changed since. Raises as `sample` does, ValueError for
    options that do not fit, and OSError if `out` cannot be written.
    """
    options, began = options.resolved(), time.perf_counter()
    source = _source(options)
    digest = _file_hash(source)
    key_record, *keys = jax.random.split(jax.random.key(options.seed), 3)
    _refuse_changed_input(earlier, digest)
    created = prepare(out, overwrite)
    try:
        question = _question(options, key_record, quiet)
        _refuse_changed_prior(earlier, question)
        posterior = question.problem.condition(question.y)
        for doubt in out_of_range(_card(options), _picture(options, question)):
            print(f"warning: {doubt}", file=sys.stderr)
        sampler = presets.sampler_of(options.sampler, posterior, options.start)
        # Here too: the search for a start takes minutes.
        sampler.check(keys[1], posterior)
        draws = _draw(options, question, posterior, sampler, keys, out / CHECKPOINT, quiet)
    except (ValueError, OSError):
        _leave_no_empty(out, created)
        raise
    except KeyboardInterrupt:
        if (out / CHECKPOINT).exists():
            kept = f"what is done is in {out / CHECKPOINT}, the same command goes on from it"
        else:
            kept = "no draw was begun, the same command starts anew"
            _leave_no_empty(out, created)
        print(f"interrupted: {kept}", file=sys.stderr)
        raise typer.Exit(130) from None
    summary = summarise(draws, question, options.problem, sampler)
    settings = {
        "options": dataclasses.asdict(options),
        "input": {"file": Path(source).name, "sha256": digest},
        "prior": question.prior,
        "irradiance": question.irradiance,
        "microscope": question.microscope,
        "sampler": draws.settings["sampler"],
        "warmup": draws.settings["warmup"],
        "results": summary.results,
        "warnings": doubts(
            summary.results,
            options.sampler,
            _card(options),
            _picture(options, question),
        ),
        "seconds": round(time.perf_counter() - began, 1),
        "versions": versions(),
    }
    write(out, draws, question, summary, settings)
    tell(out, settings)
    return settings


def _leave_no_empty(out: Path, created: bool) -> None:
    if created and not any(out.iterdir()):
        out.rmdir()


def _file_hash(path: str) -> str:
    file = split_key(path)[0]
    if not os.path.isfile(file):
        raise FileNotFoundError(f"no file {file}: give the path of a picture")
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _source(options: Options) -> str:
    return options.image or options.data or options.stack


def _question(options: Options, key: jax.Array, quiet: bool) -> Question:
    needs = SAMPLERS[options.sampler].needs
    if options.stack is not None:
        stack = read_stack(options.stack)
        return presets.measured(
            stack,
            key,
            electrons=options.electrons,
            background=options.background,
            prior=options.prior,
            needs=needs,
            progress=not quiet,
        )
    white = options.full_well if options.white is None else options.white
    camera = Poisson(white, options.bits or None, options.full_well)
    picture = read_picture(options.image or options.data, options.page)
    given = {
        name: getattr(options, name)
        for name in ("size", "prior", "irradiance", "oversampling", "leds", "colour")
    } | {"needs": needs}
    if options.data is not None:
        return presets.record(options.problem, picture, camera, **given)
    return presets.simulate(options.problem, picture, camera, key, **given)


def _picture(options: Options, question: Question) -> np.ndarray | None:
    """The recording, where it is of the object itself, in units of white."""
    return question.y if options.problem == presets.DENOISING else None


def _card(options: Options) -> dict[str, Any] | None:
    """The model card of the prior, if that is trained weights."""
    if not presets.is_trained(options.prior):
        return None
    return presets.weights_card(options.prior, SAMPLERS[options.sampler].needs)


def _refuse_changed_input(earlier: dict[str, Any] | None, digest: str) -> None:
    if earlier is not None and earlier["input"]["sha256"] != digest:
        file = _source(Options(**earlier["options"]))
        raise ValueError(f"{file} has changed since the run: put the same file there")


def _refuse_changed_prior(earlier: dict[str, Any] | None, question: Question) -> None:
    if earlier is not None and earlier["prior"] != question.prior:
        changed = sorted(set(earlier["prior"].items()) ^ set(question.prior.items()))
        raise ValueError(f"prior picture {changed[0][0]} has changed since the run: put it back")


def _draw(
    options: Options,
    question: Question,
    posterior: Posterior,
    sampler: Sampler,
    keys: list[jax.Array],
    checkpoint: Path,
    quiet: bool,
) -> Draws:
    """`keys`: of the start, and of the draws."""
    measured = question.microscope is not None
    start = presets.start_of(
        options.sampler, posterior, keys[0], options.chains, progress=not quiet,
        measured=measured, scout=_scout(options, posterior.shape), begin=options.start,
    )  # fmt: skip
    return sample(
        posterior,
        sampler,
        keys[1],
        chains=options.chains,
        draws=options.draws,
        warmup=options.warmup,
        thin=options.thin,
        start=start,
        progress=not quiet,
        checkpoint=checkpoint,
    )


def _scout(options: Options, shape: tuple[int, ...]) -> ScorePrior | None:
    """The network that searches for starts, where it is not the prior itself."""
    if options.problem != presets.PHASE_RETRIEVAL or not presets.is_trained(options.prior):
        return None
    if options.start in ("none", "hio"):
        return None
    name = presets.scout_of(options.prior)
    return None if name == options.prior else ScorePrior.load(name, shape)
