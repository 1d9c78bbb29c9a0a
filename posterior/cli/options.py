"""The options: those that decide the draws of a run, and those that every command takes."""

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..presets import (
    APPLICATIONS,
    DENOISING,
    LEDS,
    PHASE_RETRIEVAL,
    PTYCHOGRAPHY,
    SAMPLERS,
    STARTS,
    Application,
    best_sampler,
    is_shipped,
    is_trained,
    weights_card,
    whole_path,
)

Out = Annotated[Path, typer.Option(help="Folder of the results.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the results in --out.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]

_RANGES = {
    "full_well": (1, 2**23 - 1),
    "white": (1, 2**23 - 1),
    "bits": (0, 16),
    "draws": (1, None),
    "chains": (1, None),
    "warmup": (0, None),
    "thin": (1, None),
    "seed": (0, 2**31 - 1),
    "size": (4, None),
    "page": (0, None),
    "oversampling": (1, None),
}

# Options of one problem alone, and their values.
_OF_ONE = {
    "leds": (PTYCHOGRAPHY, LEDS),
    "start": (PHASE_RETRIEVAL, STARTS),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """All that decides the draws of a run. None: not said; 0 bits: no ADC."""

    problem: str
    image: str | None = None
    data: str | None = None
    stack: str | None = None
    electrons: float | None = None
    background: bool = False
    full_well: int | None = None
    white: int | None = None
    bits: int | None = None
    sampler: str | None = None
    draws: int | None = None
    chains: int = 4
    warmup: int | None = None
    thin: int | None = None
    seed: int = 0
    size: int | None = None
    prior: str | None = None
    irradiance: float | None = None
    page: int | None = None
    oversampling: int | None = None
    leds: int | None = None
    colour: str | None = None
    start: str | None = None

    def resolved(self) -> "Options":
        """With the defaults of problem and sampler filled in; refuses what cannot go together."""
        application = _known("problem", self.problem, APPLICATIONS)
        if self.sampler is not None:
            _known("sampler", self.sampler, SAMPLERS)
        prior = whole_path(self.problem, self.prior, self.sampler)
        name = self.sampler or best_sampler(self.problem, prior)
        sampling = SAMPLERS[name]
        if sum(source is not None for source in (self.image, self.data, self.stack)) != 1:
            raise ValueError(
                "give either --image (a picture to record) or --data (a recording), or --stack "
                "(of Fourier ptychography, with its microscope)"
            )
        if self.stack is not None:
            self._refuse_beside_a_stack()
        elif self.electrons is not None:
            raise ValueError(
                f"--electrons {self.electrons}: only a --stack takes them, leave it out"
            )
        elif self.background:
            raise ValueError("--background: only a --stack takes it, leave it out")
        if self.data is not None and self.full_well is None:
            raise ValueError("--data needs --full-well: how many electrons saturate a pixel")
        for option, (least, most) in _RANGES.items():
            _check_range(option, getattr(self, option), least, most)
        for option, (problem, known) in _OF_ONE.items():
            _check_of_one(option, getattr(self, option), self.problem, problem, known)
        if is_trained(prior):
            weights_card(prior, sampling.needs)
        full_well, bits = self._camera(application)
        self._check_white(full_well)
        return dataclasses.replace(
            self,
            image=_absolute(self.image),
            data=_absolute(self.data),
            stack=_absolute(self.stack),
            prior=prior if is_shipped(prior) else _absolute(prior),
            full_well=full_well,
            bits=bits,
            sampler=name,
            draws=sampling.draws if self.draws is None else self.draws,
            thin=sampling.thin if self.thin is None else self.thin,
        )

    def _camera(self, application: Application) -> tuple[int | None, int | None]:
        """Full well and bits: as said, or the application's own; a stack tells its own."""
        if self.stack is not None:
            return None, None
        full_well, bits = None, 0
        if self.image is not None:
            full_well, bits = application.full_well, application.bits
        return (
            full_well if self.full_well is None else self.full_well,
            bits if self.bits is None else self.bits,
        )

    def _check_white(self, full_well: int | None) -> None:
        if self.white is None:
            return
        if self.problem != DENOISING:
            raise ValueError(
                f"--white {self.white}: only {DENOISING} takes it, leave it out (the brightness of "
                "a field is its --irradiance)"
            )
        if self.white > full_well:
            raise ValueError(
                f"--white {self.white} electrons are more than the full well of {full_well} holds: "
                "give as many or fewer"
            )

    def _refuse_beside_a_stack(self) -> None:
        if self.problem != PTYCHOGRAPHY:
            raise ValueError(f"--stack is for {PTYCHOGRAPHY}: give --data to {self.problem}")
        of_pictures = ("full_well", "white", "bits", "size", "irradiance", "page", "oversampling")
        for name in (*of_pictures, "leds", "colour"):
            if getattr(self, name) is not None:
                option = f"--{name.replace('_', '-')} {getattr(self, name)}"
                raise ValueError(f"{option}: a stack says so itself, leave it out")


def _known(kind: str, name: str, table: dict[str, Any]) -> Any:
    if name not in table:
        raise ValueError(f"unknown {kind} {name!r}: use one of {', '.join(table)}")
    return table[name]


def study_data(data: Path | None) -> Path | None:
    """--data itself, or what has that name in the folder that POSTERIOR_DATA names."""
    home = os.environ.get("POSTERIOR_DATA")
    return Path(home) / data if home and data is not None and not data.exists() else data


def asked_of(kind: str, asked: list[str] | None, known: Iterable[str]) -> list[str]:
    """The names asked for, all that are known if none is; refuses an unknown one."""
    for name in asked or ():
        if name not in known:
            raise ValueError(f"unknown {kind} {name!r}: use one of {'; '.join(known)}")
    return list(asked or known)


def _check_range(option: str, value: int | None, least: int, most: int | None) -> None:
    if value is None:
        return
    # settings.json can hold anything.
    if not isinstance(value, int) or value < least or (most is not None and value > most):
        wanted = f"{least} or more" if most is None else f"{least} to {most}"
        raise ValueError(f"--{option.replace('_', '-')} {value}: give a whole number, {wanted}")


def _check_of_one(option: str, value: Any, problem: str, of: str, known: tuple) -> None:
    if value is None:
        return
    if problem != of:
        raise ValueError(f"--{option} {value}: only {of} takes it, leave it out")
    if value not in known:
        raise ValueError(f"--{option} {value}: give one of {', '.join(map(str, known))}")


def _absolute(path: str | None) -> str | None:
    return None if path is None else os.path.abspath(path)
