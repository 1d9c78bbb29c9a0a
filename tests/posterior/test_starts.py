"""Where the chains of the presets start: behind a Fourier transform, from the deepest valleys."""

import functools

import jax
import numpy as np
import pytest
from analytic import wiener
from skimage import data
from skimage.transform import resize

from posterior import models, presets, starts
from posterior.diagnostics import align
from posterior.estimators import half_samples, maximum_posterior
from posterior.estimators.pnp_admm import Plugged
from posterior.models import (
    Exposures,
    FourierPtychography,
    Identity,
    IntensityLikelihood,
    LinearLikelihood,
    Poisson,
)
from posterior.models.priors import ScorePrior
from posterior.problem import Problem
from posterior.samplers import AnnealedLangevin
from posterior.sampling import sample

SCOUT = {"levels": 60, "steps": 3}


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch):
    monkeypatch.setattr(presets.samplers, "_ANNEALED", SCOUT)


def annealed_alone(posterior, key, chains):
    return starts.annealed(posterior, AnnealedLangevin(**SCOUT), key, chains)


def question(name="phase-retrieval", **settings):
    picture = resize(data.camera() / 255, (24, 24), anti_aliasing=True)
    camera = Poisson(1_000_000, 16)
    return presets.simulate(name, picture, camera, jax.random.key(0), **settings)


@pytest.mark.slow
def test_starts_from_magnitudes_are_near_the_object():
    """Each chain within a few hundred nats of the truth, where annealing alone is thousands off."""
    asked = question()
    posterior = asked.problem.condition(asked.y)
    found = presets.start_of("mala", posterior, jax.random.key(1), 3)
    assert found.shape == (3, 24, 24)
    log_prob = functools.partial(starts._log_probs, posterior)
    alone = annealed_alone(posterior, jax.random.key(1), 3)
    truth = float(posterior.log_prob(asked.truth.astype(np.float32)))
    print("nats below the truth:", truth - log_prob(found), "alone:", truth - log_prob(alone))
    assert log_prob(found).min() > log_prob(alone).max()
    error = align(found, asked.truth, ["conjugate_flip"]) - asked.truth
    assert np.sqrt(np.mean(error**2, axis=(1, 2))).max() < 0.1


@pytest.mark.slow
def test_starts_are_turned_to_the_first_and_reproducible():
    asked = question(size=16)
    posterior = asked.problem.condition(asked.y)
    found = presets.start_of("nuts", posterior, jax.random.key(2), 4)
    np.testing.assert_array_equal(align(found, found[0], ["conjugate_flip"]), found)
    again = presets.start_of("nuts", posterior, jax.random.key(2), 4)
    np.testing.assert_array_equal(again, found)


def test_magnitudes_that_bound_nothing_are_annealed_alone():
    """Without oversampling hybrid input-output has nothing to go by."""
    asked = question(size=16, oversampling=1)
    posterior = asked.problem.condition(asked.y)
    found = presets.start_of("mala", posterior, jax.random.key(0), 2)
    np.testing.assert_array_equal(found, annealed_alone(posterior, jax.random.key(0), 2))


def test_samplers_that_need_no_start_get_none():
    asked = question(size=16)
    posterior = asked.problem.condition(asked.y)
    assert presets.start_of("smc", posterior, jax.random.key(0), 2) is None


def test_the_split_path_starts_from_the_picture_or_the_mean_of_its_exposures():
    one, y = LinearLikelihood(Identity((4, 4)), Poisson(100)), np.full((4, 4), 0.25)
    prior = models.GaussianField.fit([data.camera() / 255], (4, 4))
    for likelihood, recorded in ((one, y), (Exposures(one, 2), np.stack([y + 0.05, y - 0.05]))):
        posterior = Problem(likelihood, prior).condition(recorded)
        found = presets.start_of("annealed-split", posterior, jax.random.key(0), 2)
        np.testing.assert_allclose(found, [y, y], rtol=1e-6)
        assert presets.start_of("mala", posterior, jax.random.key(0), 2) is None


def test_a_real_object_behind_complex_optics_starts_real():
    optics = models.Matrix(np.exp(1j * np.arange(24).reshape(6, 4)))
    prior = models.GaussianField.fit([data.camera() / 255], (4,))
    problem = Problem(LinearLikelihood(optics, models.Gaussian(0.1)), prior)
    posterior = problem.condition(problem.simulate(jax.random.key(0))[1])
    assert not np.iscomplexobj(presets.start_of("annealed-split", posterior, jax.random.key(0), 2))
    assert not np.iscomplexobj(maximum_posterior(posterior).object)


def test_under_the_signal_error_no_pixel_starts_in_darkness_and_the_paths_run():
    """The score of x + sqrt(x) e is infinite at 0, where counts put many a start.

    A start that is given there leaves it.
    """
    prior = models.PixelPrior.gamma(3.0, 20.0, (16,))
    problem = Problem(LinearLikelihood(Identity((16,)), Poisson(8)), prior)
    y = problem.simulate(jax.random.key(0))[1]
    assert np.sum(np.asarray(y) == 0) > 2
    posterior = problem.condition(y)
    start = presets.start_of("annealed-split", posterior, jax.random.key(0), 2)
    np.testing.assert_allclose(start, np.stack([np.maximum(y, 1 / 16)] * 2))
    sampler = AnnealedLangevin(path="split", levels=20, steps=2)
    for given in (start, np.stack([y] * 2)):
        run = sample(posterior, sampler, jax.random.key(0), chains=2, start=given, progress=False)
        assert np.all(np.isfinite(run.values)) and run.values.min() > 0


def test_learned_priors_of_the_signal_error_are_annealed_without_a_descent():
    """Which is for the gaussian error: the preset must build what the sampler takes."""
    prior = ScorePrior.load("nuclei", (16, 16), "signal")
    problem = Problem(LinearLikelihood(Identity((16, 16)), Poisson(100)), prior)
    posterior = problem.condition(np.full((16, 16), 0.25))
    sampler = presets.SAMPLERS["annealed"].build(posterior)
    sampler.init(jax.random.key(0), posterior)
    assert sampler.descent == 0


def test_a_start_has_the_global_phase_of_the_prior():
    """Whose mean is 0.3 (1 + j), whatever phase the estimate came with."""
    prior = ScorePrior(wiener("score", True, dtype="float32"), (4, 6))
    o = np.asarray(prior.start(jax.random.key(0))) + 0.6 * (1 + 1j)
    turned = starts._turned((o * np.exp(1.2j)).astype(np.complex64)[None], prior)[0]
    np.testing.assert_allclose(np.abs(turned), np.abs(o), rtol=1e-5)
    assert abs(np.angle(turned.mean()) - np.pi / 4) < 1e-3


@pytest.mark.slow
def test_chains_of_a_measured_stack_start_from_halves_of_it_and_others_from_one_place():
    prior = ScorePrior(wiener("score", True, dtype="float32"), (16, 16))
    centres, radius = presets.aperture_grid(16)
    optics = FourierPtychography.from_radius((16, 16), centres, radius, 2)
    likelihood = IntensityLikelihood(optics, Poisson(1000), 0.5)
    o = presets.complex_object(resize(data.camera() / 255, (16, 16), anti_aliasing=True))
    problem = Problem(likelihood, prior)
    posterior = problem.condition(likelihood.simulate(jax.random.key(0), o))
    same, apart = (
        presets.start_of("annealed", posterior, jax.random.key(1), 2, measured=measured)
        for measured in (False, True)
    )
    np.testing.assert_array_equal(same[0], same[1])
    halves = half_samples(likelihood, posterior.y, jax.random.key(1), 2)
    np.testing.assert_array_equal(apart, starts._turned(halves, prior))
    assert np.all(apart[0] != apart[1])


@pytest.mark.slow
def test_the_best_ends_of_admm_explain_the_recording_better_than_its_solutions():
    """Under a field of the object's own spectrum, near the truth; each chain by itself."""
    rows, columns = np.meshgrid(np.fft.fftfreq(16), np.fft.fftfreq(16))
    prior = models.GaussianField(0.01 / (0.05 + np.hypot(rows, columns)) ** 2 + 1e-3, 1.5)
    optics = models.Fourier((16, 16), oversampling=2)
    problem = Problem(IntensityLikelihood(optics, Poisson(1_000_000), 1 / 400), prior)
    x, y = problem.simulate(jax.random.key(3))
    posterior = problem.condition(y)
    found = starts.by_admm(posterior, jax.random.key(1), 2)
    assert found.shape == (2, 16, 16)
    alone = starts._solutions(posterior, jax.random.fold_in(jax.random.key(1), 0), 1)
    log_prob = functools.partial(starts._log_probs, posterior)
    truth = float(posterior.log_prob(x))
    assert log_prob(found).min() > float(log_prob(alone)[0])
    # A posterior of 256 unknowns lies 128 nats below its mode, and the truth in it.
    assert log_prob(found).min() > truth - 128
    np.testing.assert_array_equal(align(found, found[0], ["conjugate_flip"]), found)
    first = starts.by_admm(posterior, jax.random.key(1), 1)
    np.testing.assert_allclose(first[0], found[0], atol=1e-6)


def test_another_prior_may_search(monkeypatch):
    asked = []

    def admm(likelihood, y, start, denoiser, levels, iterations):
        asked.append(denoiser)
        return Plugged(start, 0.0)

    monkeypatch.setattr(starts, "plug_and_play_admm", admm)
    monkeypatch.setattr(starts, "_solutions", lambda *_: np.ones((8, 16, 16), np.float32))
    optics = models.Fourier((16, 16), oversampling=2)
    likelihood = IntensityLikelihood(optics, Poisson(100_000), 1 / 400)
    prior, scout = (ScorePrior(wiener("score", False, dtype="float32"), (16, 16)) for _ in "ab")
    y = likelihood.simulate(jax.random.key(0), np.ones((16, 16), np.float32))
    posterior = Problem(likelihood, prior).condition(y)
    for given, used in ((None, posterior.prior), (scout, scout)):
        starts.by_admm(posterior, jax.random.key(1), 1, scout=given)
        assert len(asked) == 8 and all(denoiser is used for denoiser in asked)
        asked.clear()


def test_a_large_network_has_the_small_one_of_its_name_for_scout(monkeypatch):
    assert presets.scout_of("natural-large") == "natural"
    for prior in ("natural", "nowhere-large", "mine.safetensors"):
        assert presets.scout_of(prior) == prior
    asked = []
    monkeypatch.setattr(presets.samplers, "by_admm", lambda *given: asked.append(given[-1]))
    optics = models.Fourier((16, 16), oversampling=2)
    likelihood = IntensityLikelihood(optics, Poisson(100_000), 1 / 400)
    x = np.full((16, 16), 0.4, np.float32)
    y = likelihood.simulate(jax.random.key(0), x)
    scout = ScorePrior.load("natural", (16, 16))
    posterior = Problem(likelihood, ScorePrior.load("natural-large", (16, 16))).condition(y)
    presets.start_of("annealed", posterior, jax.random.key(1), 1, scout=scout)
    assert asked == [scout]


def test_under_a_learned_prior_real_objects_start_from_admm_and_complex_ones_from_a_search(
    monkeypatch,
):
    """And annealing begins near the noise where the start is to be kept, else broadly."""
    used = []
    for name in ("by_admm", "from_magnitudes"):
        monkeypatch.setattr(presets.samplers, name, lambda *_, name=name: used.append(name))
    optics = models.Fourier((16, 16), oversampling=2)
    likelihood = IntensityLikelihood(optics, Poisson(100_000), 1 / 400)
    for complex_valued, search in ((False, "by_admm"), (True, "from_magnitudes")):
        prior = ScorePrior(wiener("score", complex_valued, dtype="float32"), (16, 16))
        y = likelihood.simulate(jax.random.key(0), np.ones((16, 16), np.float32))
        posterior = Problem(likelihood, prior).condition(y)
        presets.start_of("annealed", posterior, jax.random.key(1), 1)
        assert used.pop() == search
        broadest = presets.learned_annealing(posterior).sigma_max
        near = 4 * float(posterior.data_level())
        assert broadest == (float(prior.scale) / 2 if complex_valued else near)
        above = presets.sampler_of("annealed", posterior, "none")
        assert above.sigma_max == float(posterior.annealing_range("convolved")[0])
        assert presets.start_of("annealed", posterior, jax.random.key(1), 1, begin="none") is None
        presets.start_of("annealed", posterior, jax.random.key(1), 1, begin="hio")
        assert used.pop() == "from_magnitudes"
        assert presets.sampler_of("annealed", posterior, "hio").sigma_max == float(prior.scale) / 2
        if complex_valued:
            with pytest.raises(ValueError, match="a learnt prior of real objects, use hio"):
                presets.start_of("annealed", posterior, jax.random.key(1), 1, begin="admm")
        split = presets.learned_annealing(posterior, "split")
        assert split.sigma_min < split.sigma_max <= float(posterior.annealing_range("split")[0])


def test_behind_bright_fields_alone_chains_start_from_a_run_each():
    """Their slow phases are not those of quasi-Newton, to which no LED told them."""
    prior = ScorePrior(wiener("score", True, dtype="float32"), (16, 16))
    axis = np.arange(-1, 2)
    centres = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    optics = FourierPtychography.from_radius((16, 16), centres, 3.9, 2)
    likelihood = IntensityLikelihood(optics, Poisson(1000), 0.2)
    truth = np.asarray(prior.sample(jax.random.key(3)), np.complex64) + 1.5 * (1 + 1j)
    posterior = Problem(likelihood, prior).condition(
        likelihood.simulate(jax.random.key(0), truth / np.abs(truth).max())
    )
    climbed = starts.for_ptychography(posterior, jax.random.key(1), 2)
    np.testing.assert_array_equal(climbed[0], climbed[1])
    apart = presets.start_of("annealed", posterior, jax.random.key(1), 2)
    assert np.all(apart[0] != apart[1]) and np.all(apart[0] != climbed[0])
