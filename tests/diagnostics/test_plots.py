"""The figure shows every panel it promises, with one scale a kind, and the maps behind it."""

import numpy as np
import pytest
from matplotlib import pyplot

from posterior.diagnostics.gauge import align
from posterior.diagnostics.plots import complex_maps, overview

RNG = np.random.default_rng(0)
TRUTH = RNG.random((12, 16))
DRAWS = TRUTH + 0.1 * RNG.standard_normal((2, 30, 12, 16))
FIELD = (0.5 + TRUTH) * np.exp(1j * (TRUTH - 0.5))


def _field_draws(count=40):
    noise = RNG.standard_normal((2, count, 12, 16, 2)) @ (1, 1j)
    turn = np.exp(2j * np.pi * RNG.random((2, count, 1, 1)))
    return (FIELD + 0.02 * noise) * turn


def _titles(panels):
    return [axes.get_title() for axes in panels]


def _real(truth=TRUTH, path=None, **kwargs):
    mean, sd = DRAWS.mean(axis=(0, 1)), DRAWS.std(axis=(0, 1))
    return overview(path, truth, TRUTH[::-1], list(DRAWS[0]), mean, sd, 3.3 * sd, **kwargs)


def _complex(truth=FIELD):
    values = align(_field_draws(), FIELD, ["global_phase"])
    maps = complex_maps(values)
    sd = np.stack([maps.sd_amplitude, maps.sd_phase])
    width = np.stack([maps.width_amplitude, maps.width_phase])
    return overview(None, truth, TRUTH, list(values[0]), values.mean(axis=(0, 1)), sd, width)


def test_real_panels():
    assert _titles(_real()) == [
        "truth", "recording", "posterior mean", "standard deviation",
        "a draw", "another draw", "error of the mean", "width of 90 % interval",
    ]  # fmt: skip


def test_without_truth_its_panels_are_left_out():
    for titles in (_titles(_real(None)), _titles(_complex(None))):
        assert "truth" not in titles
        assert "error of the mean" not in titles
    assert len(_titles(_real(None))) == 6


def test_complex_panels():
    titles = _titles(_complex())
    assert titles.count("truth") == 1
    assert len(titles) == 15
    last = ["sd of amplitude", "90 % width, amplitude", "sd of phase", "90 % width, phase"]
    assert set(last) <= set(titles)


def test_pictures_of_one_kind_share_a_scale():
    panels = {axes.get_title(): axes.images[0] for axes in _real(data_is_object=True)}
    shared = ("truth", "recording", "posterior mean", "a draw", "another draw")
    assert len({id(panels[name].norm) for name in shared}) == 1
    assert panels["error of the mean"].norm is panels["standard deviation"].norm


def test_titles_and_panels_do_not_overlap():
    for panels in (_real(title="a headline"), _complex(), _real(None), _complex(None)):
        figure = panels[0].figure
        figure.draw_without_rendering()
        boxes = [axes.get_tightbbox() for axes in panels]
        for i, a in enumerate(boxes):
            assert figure.bbox.count_contains([(a.x0, a.y0), (a.x1, a.y1)]) == 2
            assert not any(a.overlaps(b) for b in boxes[i + 1 :])


def test_what_is_no_run_is_refused():
    mean = DRAWS.mean(axis=(0, 1))
    for draws in ([TRUTH], [TRUTH, TRUTH[1:]]):
        with pytest.raises(ValueError, match=r"beside a mean of \(12, 16\): give two draws"):
            overview(None, TRUTH, TRUTH, draws, mean, mean, mean)


def test_the_file_is_written_and_no_global_state_is_touched(tmp_path):
    _real(path=tmp_path / "a.part")
    assert (tmp_path / "a.part").read_bytes().startswith(b"\x89PNG")
    assert pyplot.get_fignums() == []


def test_phase_maps_do_not_know_the_cut():
    """Phases about +-pi have the same spread as those about zero."""
    values = align(_field_draws(), FIELD, ["global_phase"])
    here, there = complex_maps(values), complex_maps(-values)
    for name in ("sd_phase", "width_phase", "sd_amplitude"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), rtol=1e-6)
    # sd of a phase is the noise across it over the amplitude.
    expected = 0.02 / np.abs(FIELD)
    assert np.median(here.sd_phase / expected) == pytest.approx(1, abs=0.1)
