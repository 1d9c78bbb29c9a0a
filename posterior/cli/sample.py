"""`posterior sample`: the posterior of a picture or of a recording."""

import dataclasses
from typing import Annotated

import typer

from ..presets import APPLICATIONS, COLOURS, LEDS, SAMPLERS, STARTS
from .options import Options, Out, Overwrite, Quiet
from .run import run


def command(
    problem: Annotated[str, typer.Argument(help=f"One of {', '.join(APPLICATIONS)}.")],
    out: Out,
    image: Annotated[str | None, typer.Option(help="A clean picture, to be recorded.")] = None,
    data: Annotated[str | None, typer.Option(help="A recording: codes, or fractions of 1.")] = None,
    stack: Annotated[
        str | None, typer.Option(help="A measured stack of ptychography, NPZ with its microscope.")
    ] = None,
    electrons: Annotated[
        float | None, typer.Option(help="A unit of a stack's intensity; unsaid: by its noise.")
    ] = None,
    background: Annotated[
        bool, typer.Option("--background", help="The images of a stack may hold even light.")
    ] = False,
    full_well: Annotated[int | None, typer.Option(help="Electrons at saturation.")] = None,
    white: Annotated[
        int | None,
        typer.Option(help="Electrons of the prior's 1, where the full well holds more."),
    ] = None,
    bits: Annotated[int | None, typer.Option(help="Of the ADC; 0: none.")] = None,
    sampler: Annotated[str | None, typer.Option(help=f"One of {', '.join(SAMPLERS)}.")] = None,
    draws: Annotated[int | None, typer.Option(help="Draws a chain.")] = None,
    chains: Annotated[int, typer.Option(help="Independent chains.")] = 4,
    warmup: Annotated[int | None, typer.Option(help="Steps that tune the sampler.")] = None,
    thin: Annotated[int | None, typer.Option(help="Steps from draw to draw.")] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same draws.")] = 0,
    size: Annotated[int | None, typer.Option(help="Pixels a side of the object.")] = None,
    prior: Annotated[
        str | None,
        typer.Option(help="A picture or a folder of them, or trained weights by name or path."),
    ] = None,
    irradiance: Annotated[float | None, typer.Option(help="Signal at a field of 1.")] = None,
    page: Annotated[int | None, typer.Option(help="Of a file of many, from 0.")] = None,
    oversampling: Annotated[int | None, typer.Option(help="Of the far field.")] = None,
    leds: Annotated[
        int | None,
        typer.Option(help=f"Of simulated ptychography: one of {', '.join(map(str, LEDS))}."),
    ] = None,
    colour: Annotated[
        str | None,
        typer.Option(help=f"Of a picture in colour, under a grey prior: {' or '.join(COLOURS)}."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help=f"Of chains of phase retrieval: one of {', '.join(STARTS)}."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Draw the posterior of a picture that is recorded (--image), or of a recording (--data)."""
    said = locals()
    options = {field.name: said[field.name] for field in dataclasses.fields(Options)}
    run(Options(**options), out, overwrite, quiet)
