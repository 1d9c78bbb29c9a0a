"""The gallery's exact draws: calibrated, and equal to what others find."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import posterior as ps
from known import grid_posterior
from posterior import samplers
from posterior.diagnostics import sbc
from posterior.models.gallery import (
    GALLERY,
    mixture_of_25,
    one_complex_pixel,
    quantised_counts,
)
from posterior.models.laplace import laplace

BY_LAPLACE = (
    "six-pixel phase retrieval",
    "coded diffraction, 4 x 4",
    "ptychography, 6 x 6",
    "digits, 8 x 8",
)
QUICK = ("linear Gaussian, complex", "mixture, 8 dimensions")
SLOW = tuple(name for name in GALLERY if name not in QUICK)


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
def test_exact_draws_are_calibrated(name):
    """By the quantities that see 10 % of a temperature in 400 simulations (test_power.py)."""
    known = GALLERY[name]()
    problem = ps.Problem(known.likelihood, known.prior)
    found = sbc(
        problem, lambda key, p: known.exact(key, p.y, 50)[None], jax.random.key(0), 400,
        progress=False,
    )  # fmt: skip
    assert found.verdict(alpha=0.001).startswith("passes"), found.verdict()


def recorded(known):
    problem = ps.Problem(known.likelihood, known.prior)
    y = problem.simulate(jax.random.key(1))[1]
    return problem.condition(y), y


def parts(x):
    return np.concatenate([np.abs(x), x.real, x.imag], axis=-1) if np.iscomplexobj(x) else x


def effective(known, y, count=20_000):
    """How many of the exact draws count on this recording."""
    return count if known.proposed is None else known.proposed(jax.random.key(2), y).effective()


@pytest.mark.slow
def test_one_pixel_agrees_with_a_grid_of_real_and_imaginary_parts(x64):
    known = one_complex_pixel(0.1)
    posterior, y = recorded(known)
    draws = np.asarray(known.exact(jax.random.key(2), y, 10_000))[:, 0]
    grid, weight = grid_posterior(posterior)
    for f in (np.abs, np.real, np.imag, lambda o: np.abs(o) ** 4):
        mean, square = np.sum(weight * f(grid)), np.sum(weight * f(grid) ** 2)
        assert abs(f(draws).mean() - mean) < 4 * np.sqrt((square - mean**2) / len(draws))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "two-pixel phase retrieval",
        "mixture, 8 dimensions",
        "Poisson at 4 bits",
        "six-pixel phase retrieval",
        "coded diffraction, 4 x 4",
        "ptychography, 6 x 6",
        "digits, 8 x 8",
    ],
)
def test_moments_agree_with_tempered_smc(x64, name):
    """Populations of their own, whose means scatter by the Monte-Carlo error."""
    known = GALLERY[name]()
    posterior, y = recorded(known)
    exact = np.asarray(known.exact(jax.random.key(2), y, 20_000)).reshape(20_000, -1)
    run = ps.sample(
        posterior, samplers.TemperedSMC(), jax.random.key(3), chains=16, draws=500, progress=False
    )
    # Real and imaginary parts too: modes may differ by a turn alone.
    exact, values = (parts(a) for a in (exact, run.values.reshape(16, 500, -1)))
    means = values.mean(axis=1)
    count = effective(known, y)
    error = np.hypot(means.std(axis=0, ddof=1) / 4, exact.std(axis=0) / np.sqrt(count))
    z = (means.mean(axis=0) - exact.mean(axis=0)) / error
    # Student's t of 15 populations, for so many numbers: once in 200 correct runs.
    assert np.abs(z).max() < scipy.stats.t(15).isf(0.005 / 2 / z.size)


@pytest.mark.slow
def test_laplace_weighs_its_draws_of_a_gaussian_equally(x64):
    """There the approximation is exact, but for the tails of Student's t."""
    known = GALLERY["mixture, 8 dimensions"]()
    _, y = recorded(known)
    found = laplace(jax.random.key(0), known.likelihood, known.prior, y, 4000, freedom=1e8)
    assert found.effective() > 0.999 * 4000
    draws = np.asarray(found.resampled(jax.random.key(1), 4000))
    exact = np.asarray(known.exact(jax.random.key(2), y, 4000))
    z = (draws.mean(axis=0) - exact.mean(axis=0)) / (exact.std(axis=0) * np.sqrt(3 / 4000))
    # Resampling 4000 of 4000 doubles the variance of a mean; exact draws add theirs.
    assert np.abs(z).max() < 4


def test_weights_of_laplace_give_the_moments(x64):
    """Of a mixture of normals, by proposals with the tails of Student's t, from three starts."""
    known = GALLERY["mixture, 8 dimensions"]()
    _, y = recorded(known)
    found = laplace(jax.random.key(0), known.likelihood, known.prior, y, 20_000, starts=3)
    w = np.asarray(jax.nn.softmax(found.log_weights))
    mean = w @ np.asarray(found.objects)
    error = np.sqrt(w**2 @ (np.asarray(found.objects) - mean) ** 2)
    exact = np.asarray(known.exact(jax.random.key(2), y, 20_000))
    z = (mean - exact.mean(axis=0)) / np.hypot(error, exact.std(axis=0) / np.sqrt(20_000))
    assert np.abs(z).max() < 4
    assert found.effective() < 0.99 * 20_000


@pytest.mark.slow
def test_laplace_without_any_weight_draws_nan():
    known = GALLERY["mixture, 8 dimensions"]()
    _, y = recorded(known)
    found = laplace(jax.random.key(0), known.likelihood, known.prior, jnp.nan * y, 20)
    assert np.isnan(found.resampled(jax.random.key(1), 3)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_LAPLACE)
def test_draws_by_importance_count_for_enough(name):
    """On every one of 100 recordings; the least and the median are printed."""
    known = GALLERY[name]()
    problem = ps.Problem(known.likelihood, known.prior)

    def one(key):
        key_joint, key_proposed = jax.random.split(key)
        y = problem.simulate(key_joint)[1]
        return known.proposed(key_proposed, y).effective()

    keys = jax.random.split(jax.random.key(0), 100)
    found = np.asarray(jax.jit(lambda keys: jax.lax.map(one, keys, batch_size=20))(keys))
    print(
        f"\n{name}, {known.basis}: {found.min():.0f} count at the least, {np.median(found):.0f} "
        "at the median"
    )
    # As many as a calibration takes of them.
    assert found.min() > 50


def test_a_code_holds_all_of_its_counts():
    """Code 3 of 16 is 17 to 23 electrons of 100: a mixture of gammas by their evidence."""
    counts = np.arange(17, 24)
    weights = scipy.stats.nbinom(3, 12 / 112).pmf(counts)
    mixture = scipy.stats.gamma(3 + counts, scale=1 / 112)
    moments = [np.average(mixture.moment(k), weights=weights) for k in (1, 2, 3, 4)]
    draws = quantised_counts().exact(jax.random.key(0), jnp.full(16, 3 / 15), 2000)
    draws = np.asarray(draws, float)
    assert draws.shape == (2000, 16)
    for k in (1, 2):
        error = np.sqrt((moments[2 * k - 1] - moments[k - 1] ** 2) / draws.size)
        assert abs(np.mean(draws**k) - moments[k - 1]) < 4 * error
    # In the middle of the code alone draws would be narrower, by 20 such errors.
    sd = np.sqrt(moments[1] - moments[0] ** 2)
    assert abs(draws.std() / sd - 1) < 4 * np.sqrt(0.6 / draws.size)
    assert mixture.std()[3] / sd < 1 - 0.05


def test_mixtures_of_25_are_as_published_and_one_program():
    """Cardoso et al.'s modes; problems differ in numbers alone, not in what is compiled."""
    known = [mixture_of_25(80, 4, seed) for seed in (0, 1)]
    modes = np.unique(known[0].modes[:, :2], axis=0)
    assert known[0].modes.shape == (25, 80)
    assert sorted(set(modes.ravel())) == [-16, -8, 0, 8, 16] and len(modes) == 25
    assert np.all(known[0].modes == np.tile(known[0].modes[:, :2], 40))
    shapes = [jax.tree.map(jnp.shape, recorded(k)[0]) for k in known]
    assert jax.tree.structure(shapes[0]) == jax.tree.structure(shapes[1])
    # In units of the noise the largest singular value is one over a uniform number.
    largest = [
        np.linalg.norm(mixture_of_25(8, 2, i).likelihood.optics.matrix, 2) for i in range(40)
    ]
    assert scipy.stats.kstest(1 / np.array(largest), "uniform").pvalue > 1e-3


@pytest.mark.slow
def test_modes_are_places_of_the_prior():
    for build in GALLERY.values():
        known = build()
        if known.modes is not None:
            assert known.modes.shape[1:] == known.prior.shape
            at_modes = jax.vmap(known.prior.log_prob)(jnp.asarray(known.modes, known.prior.dtype))
            drawn = jax.vmap(known.prior.sample)(jax.random.split(jax.random.key(0), 200))
            assert at_modes.min() > np.quantile(jax.vmap(known.prior.log_prob)(drawn), 0.05)
