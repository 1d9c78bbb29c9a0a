"""Cameras: the simulator and the log-probability must be the same camera."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from posterior.models import camera as camera_module
from posterior.models.camera import Gaussian, Poisson, PoissonGaussian
from posterior.models.counts import poisson_log_interval

POISSON = [Poisson(10, 1), Poisson(100), Poisson(255, 4), Poisson(100, 8), Poisson(5000, 8)]
POISSON += [Poisson(1e6, 12), Poisson(25, None, 40), Poisson(100, 6, 131)]
NOISY = [PoissonGaussian(100, 0.4, 4), PoissonGaussian(5000, 8, 8)]
ONE_OF_EACH = [Poisson(100, 8), Poisson(1e6, 12), PoissonGaussian(100, 0.4, 4)]
EVERYWHERE = [(c, "float32") for c in POISSON + NOISY] + [(c, "float64") for c in ONE_OF_EACH]

LIGHTS = np.array([-5, -1e-3, -1e-30, 0, 1e-30, 1e-9, 0.004, 0.1, 0.6, 0.999, 1, 1.02, 5])


@pytest.fixture
def dtype(request):
    with jax.enable_x64(request.param == "float64"):
        yield request.param


everywhere = pytest.mark.parametrize(("camera", "dtype"), EVERYWHERE, ids=repr, indirect=["dtype"])


def recordings(camera):
    """Every value the camera can record, in float64."""
    top = camera.holds if camera.bits is None else 2**camera.bits - 1
    return np.arange(top + 1) * (camera.holds / camera.full_well / top)


@eqx.filter_jit
def draw(camera, key, light):
    return camera.sample(key, light)


@eqx.filter_jit
def value_and_score(camera, y, light):
    """Of all recordings (rows) and lights (columns), in one compilation."""
    light = jnp.broadcast_to(light, (y.size, light.size))
    value = partial(camera.log_prob, y[:, None])
    return jax.jvp(value, (light,), (jnp.ones_like(light),))


def table(camera, dtype, lights=LIGHTS):
    y, light = jnp.asarray(recordings(camera), dtype), jnp.asarray(lights, dtype)
    value, score = value_and_score(camera, y, light)
    assert value.dtype == score.dtype == dtype
    return np.asarray(value, float), np.asarray(score, float)


# ---- probabilities -------------------------------------------------------------------------------


@everywhere
def test_probabilities_of_all_recordings_add_up_to_one(camera, dtype):
    total = np.sum(np.exp(table(camera, dtype)[0][:, LIGHTS >= 0]), axis=0)
    np.testing.assert_allclose(total, 1, atol=2e-5 if dtype == "float32" else 1e-6)


@everywhere
def test_finite_everywhere(camera, dtype):
    value, score = table(camera, dtype)
    possible = camera.holds >= value.shape[0] - 1 or isinstance(camera, PoissonGaussian)
    assert np.all(np.isfinite(value)) or not possible
    assert np.all(np.isfinite(score))
    assert np.all(score[1:, LIGHTS < 0] >= 0)  # any electron points from darkness to light


@pytest.mark.parametrize("camera", ONE_OF_EACH, ids=repr)
def test_score_is_the_finite_difference(x64, camera):
    step = 1e-4 * LIGHTS
    above, below = (table(camera, "float64", LIGHTS + d)[0] for d in (step, -step))
    possible = np.ix_(np.isfinite(above[:, 0]), LIGHTS > 0.001)
    difference = (above[possible] - below[possible]) / (2 * step[LIGHTS > 0.001])
    score = table(camera, "float64")[1][possible]
    assert np.all(np.abs(score - difference) < 1e-4 * np.abs(score) + 1e-3 / camera.sigma0)


def test_quantised_probability_adds_counts():
    """Against scipy, through the definition of the code."""
    camera, light = Poisson(100, 4), 0.62
    counts = np.arange(400)
    codes = np.floor(np.minimum(counts, 100) * 15 / 100 + 0.5)
    expected = [stats.poisson.pmf(counts[codes == c], 62).sum() for c in range(16)]
    value = jnp.exp(camera.log_prob(recordings(camera), jnp.float32(light)))
    np.testing.assert_allclose(value, expected, rtol=2e-5, atol=1e-12)


def chi_square(camera, model, column, dtype, draws=20_000):
    """p-value of draws of `camera` under the probabilities of `model`, cells of 10 draws."""
    light = jnp.full(draws, LIGHTS[column], dtype)
    y = np.asarray(draw(camera, jax.random.key(column), light), float)
    values = recordings(camera)
    place = np.round(y / values[-1] * (values.size - 1)).astype(int)
    observed = np.bincount(place, minlength=values.size)
    probability = np.exp(table(model, dtype)[0][:, column])
    cell = np.minimum(np.cumsum(probability) * draws / 10, draws).astype(int)
    expected = np.bincount(cell, probability) * draws
    observed = np.bincount(cell, observed)
    few = expected < 5
    expected = np.append(expected[~few], expected[few].sum() + 1e-3)
    observed = np.append(observed[~few], observed[few].sum())
    statistic = np.sum((observed - expected) ** 2 / np.maximum(expected, 1))
    return stats.chi2.sf(statistic, max(expected.size - 1, 1))


@everywhere
def test_histogram_is_the_probability(camera, dtype):
    for column in np.flatnonzero(np.isin(LIGHTS, [0.004, 0.6, 1.0])):
        p = chi_square(camera, camera, column, dtype)
        assert p > 1e-4, (LIGHTS[column], p)


def test_histogram_finds_a_wrong_full_well():
    """A full well 10 % off: the mean signal is the same, only the noise differs."""
    column = int(np.flatnonzero(LIGHTS == 0.6)[0])
    assert chi_square(Poisson(100, 8), Poisson(110, 8), column, "float32") < 1e-6


def test_a_well_that_holds_more_clips_there_and_not_at_one():
    """Of a signal of 1, 25 electrons: 40 or more with the probability that SciPy gives."""
    y = np.asarray(draw(Poisson(25, None, 40), jax.random.key(5), jnp.ones(20_000, "float32")))
    np.testing.assert_allclose(y.max(), 1.6, rtol=1e-6)
    assert abs(y.mean() - 1) < 4 * 0.2 / np.sqrt(y.size)
    tail = stats.poisson.sf(39, 25)
    assert abs(np.mean(y == y.max()) - tail) < 4 * np.sqrt(tail / y.size)
    value = Poisson(25, None, 40).log_prob(np.float32(1.6), jnp.float32(1.0))
    np.testing.assert_allclose(np.exp(value), tail, rtol=1e-5)
    saturated = Poisson(25).log_prob(np.float32(1.0), jnp.float32(1.0))
    np.testing.assert_allclose(np.exp(saturated), stats.poisson.sf(24, 25), rtol=1e-5)


def test_histogram_of_unquantised_read_noise():
    camera = PoissonGaussian(1000, 3.0)
    edges = np.arange(-12, 1012, 0.3) / 1000  # 0.1 read noise: the midpoint rule is exact to 1e-3
    middle = jnp.asarray((edges[1:] + edges[:-1]) / 2, "float32")
    for light in (0.002, 0.4, 0.99):
        draws = draw(camera, jax.random.key(1), jnp.full(20_000, light, "float32"))
        density = np.asarray(jnp.exp(camera.log_prob(middle, jnp.full_like(middle, light))), float)
        mass = density * 0.3 / 1000
        np.testing.assert_allclose(mass.sum(), 1, atol=1e-3)
        cdf = np.append(0, np.cumsum(mass))
        p = stats.kstest(np.asarray(draws), lambda y, cdf=cdf: np.interp(y, edges, cdf)).pvalue
        assert p > 1e-4


def test_variance_of_a_million_electrons():
    """jax.random.poisson alone is 2 % off here."""
    n = 100_000
    camera = Poisson(2_000_000)
    y = camera.sample(jax.random.key(2), jnp.full(n, 0.5, "float32"))
    electrons = np.asarray(y, float) * 2e6
    assert abs(electrons.mean() - 1e6) < 4 * np.sqrt(1e6 / n)
    assert abs(electrons.var() / 1e6 - 1) < 4 * np.sqrt(2 / n)


# ---- scores --------------------------------------------------------------------------------------

SCORED = [
    (Poisson(100, 8), 0.95, "float32"),
    (Poisson(1e6, 8), 0.5, "float64"),
    (PoissonGaussian(100, 0.4, 4), 0.2, "float64"),
    (Gaussian(0.1), 0.4, "float32"),
]


@pytest.mark.parametrize(("camera", "light", "dtype"), SCORED, ids=repr, indirect=["dtype"])
def test_score_has_mean_zero_and_the_fisher_information(camera, light, dtype):
    n = 20_000
    expected = jnp.full(n, light, dtype)
    y = draw(camera, jax.random.key(3), expected)
    score, slope = jax.jit(lambda e: jax.jvp(partial(camera.score, y), (e,), (jnp.ones_like(e),)))(
        expected
    )
    score, slope = np.asarray(score, float), np.asarray(slope, float)
    assert abs(score.mean()) < 4 * score.std() / np.sqrt(n)
    identity = score**2 + slope
    assert abs(identity.mean()) < 4 * identity.std() / np.sqrt(n) + 1e-6 * score.var()


def test_complex_score_is_the_gradient_in_re_and_im(x64):
    camera = Gaussian(0.3)
    y, expected = jnp.asarray([1 + 2j, 0.5j]), jnp.asarray([0.4 - 1j, 0.1 + 0j])
    np.testing.assert_allclose(camera.score(y, expected), (y - expected) / 0.09, rtol=1e-12)
    density = stats.norm.logpdf(y.real, expected.real, 0.3)
    density = density + stats.norm.logpdf(y.imag, expected.imag, 0.3)
    np.testing.assert_allclose(camera.log_prob(y, expected), density, rtol=1e-12)


def test_gaussian_noise_has_sigma_in_each_part():
    noise = Gaussian(0.5).sample(jax.random.key(4), jnp.zeros(100_000, "complex64"))
    for part in (noise.real, noise.imag):
        assert abs(np.var(part) / 0.25 - 1) < 4 * np.sqrt(2 / 1e5)


# ---- robustness ----------------------------------------------------------------------------------


def test_unreachable_code_is_impossible():
    camera = Poisson(10, 8)
    expected = jnp.full(256, 0.4, "float32")
    y = recordings(camera)
    possible = np.isfinite(camera.log_prob(y, expected))
    np.testing.assert_array_equal(np.flatnonzero(possible), np.floor(np.arange(11) * 25.5 + 0.5))
    assert np.all(np.isfinite(camera.score(y, expected)))


@pytest.mark.parametrize("camera", [Poisson(1e6, 16), Poisson(8388607, 16), Poisson(77, 5)])
def test_sample_and_log_prob_use_the_same_codes(camera):
    """Electrons at both ends of a code, in float32, as the definition in whole numbers has them."""
    from posterior.models.camera import _first_counts

    firsts, top = _first_counts(camera.full_well, camera.bits), 2**camera.bits - 1
    for code in (0, 1, top // 3, top):
        for count in (firsts[code], firsts[code + 1] - 1):
            assert (2 * int(count) * top + camera.full_well) // (2 * camera.full_well) == code


def test_follows_float32_inside_x64(x64):
    light, y = jnp.full(3, 0.5, "float32"), np.full(3, 0.5)
    for camera in (Poisson(100, 8), Poisson(100), PoissonGaussian(100, 0.4, 4), Gaussian(0.1)):
        for result in (
            jax.eval_shape(camera.sample, jax.random.key(0), light),
            jax.eval_shape(camera.log_prob, y, light),
            jax.eval_shape(camera.score, y, light),
        ):
            assert result.dtype == jnp.float32


@pytest.mark.slow
def test_same_key_same_draws_and_vmap_is_a_loop():
    light = jnp.linspace(0, 1.1, 12, dtype="float32").reshape(3, 4)
    keys = jax.random.split(jax.random.key(5), 3)
    for camera in (Poisson(100, 8), Gaussian(0.1)):
        y = eqx.filter_vmap(draw, in_axes=(None, 0, 0))(camera, keys, light)
        loop = [draw(camera, key, x) for key, x in zip(keys, light)]
        np.testing.assert_array_equal(y, jnp.stack(loop))
        value = jax.vmap(camera.log_prob)(light, light)
        loop = [camera.log_prob(x, x) for x in light]
        np.testing.assert_allclose(value, jnp.stack(loop), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shared", [True, False], ids=["one recording", "a recording each"])
def test_tail_is_summed_for_saturated_pixels_alone_when_vmapped(monkeypatch, shared):
    camera, summed = Poisson(100), []

    def counted(start, stop, lam, width):
        jax.debug.callback(lambda: summed.append(lam.size))
        return poisson_log_interval(start, stop, lam, width)

    monkeypatch.setattr(camera_module, "poisson_log_interval", counted)
    chains = jax.jit(jax.vmap(camera.log_prob, in_axes=(None if shared else 0, 0)))
    light = jnp.full((2, 50), 0.5, "float32")
    y = light[0] if shared else light
    jax.block_until_ready(chains(y, light))
    assert summed == []
    jax.block_until_ready(chains(y.at[..., -1].set(1.0), light))
    jax.effects_barrier()
    assert summed == [32 * 2 if shared else 32], "a block of pixels"


# ---- what is told --------------------------------------------------------------------------------


def test_noise_levels():
    assert Poisson(100, 8).sigma0 == 0.1
    assert Poisson(100).read_variance == 0
    assert Poisson(100, 1).read_variance == 1 / 12
    assert Poisson(100, 1, 200).read_variance == 4 / 12
    assert Poisson(100, 8, 200).sigma0 == 0.1
    assert PoissonGaussian(400, 2).read_variance == 0.005**2
    assert Gaussian(0.5).read_variance == 0.25
    assert Gaussian(0.5).sigma0 == 0
    assert [c.counting for c in (Gaussian(1), Poisson(1), PoissonGaussian(1, 1))] == [0, 1, 1]


@pytest.mark.parametrize("camera", [*POISSON, *NOISY, PoissonGaussian(100, 3)], ids=repr)
def test_check_accepts_what_the_camera_records(camera):
    y = draw(camera, jax.random.key(6), jnp.linspace(0, 1.2, 20_000, dtype="float32"))
    camera.check(y)
    camera.check(np.asarray(y, float))


@pytest.mark.parametrize("camera", [Poisson(5000, 12), Poisson(5000, 12, 7001)], ids=repr)
def test_codes_come_back(camera):
    codes = np.arange(4096, dtype=np.uint16)
    y = camera.from_codes(codes)
    camera.check(y)
    np.testing.assert_array_equal(np.round(np.asarray(y, float) / camera.highest * 4095), codes)


@pytest.mark.parametrize(
    ("camera", "y", "sentence"),
    [
        (Poisson(100), [np.nan], "not finite.*mask or repair"),
        (Poisson(100), [-0.01], r"negative \(-1 electrons\).*dark level"),
        (Poisson(100), [1.7], r"y = 1.7 is above the full well \(1 = 100 electrons\).*divide"),
        (Poisson(100, 8, 160), [1.7], r"above the full well \(1.6 = 160 electrons\)"),
        (Poisson(100, 8), np.array([3]), "integer data.*ADC codes.*camera.from_codes"),
        (Poisson(100), np.array([1j]), "complex data.*intensities"),
        (Poisson(100, 8), [0.5], "not on the grid k/255.*8-bit.*set bits"),
        (Poisson(100), [0.123456], "12.3456 electrons, not a whole number.*PoissonGaussian"),
        (Poisson(10, 8), [1 / 255], "code 1, which no whole number.*raise full_well"),
        (PoissonGaussian(100, 1.0), [-0.2], "far below zero"),
        (PoissonGaussian(100, 1.0, 8), [-1 / 255], "negative"),
        (PoissonGaussian(100, 1.0), [1.2], "above the full well"),
        (Gaussian(1.0), np.array([3]), "integer data.*full scale"),
        (Gaussian(1.0), [np.inf], "not finite"),
    ],
)
def test_check_names_value_and_remedy(camera, y, sentence):
    with pytest.raises(ValueError, match=sentence):
        camera.check(np.asarray(y))


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Poisson(0), "full_well = 0 must be a positive number"),
        (lambda: Poisson(100.5), "full_well = 100.5 must be a whole number"),
        (lambda: Poisson(1e7), "full_well = 10000000.0 must be a whole number.*at most 8388607"),
        (lambda: Poisson(100, holds=120.5), "holds = 120.5 must be a whole number"),
        (lambda: Poisson(100, holds=99), "holds = 99 electrons, and a signal of 1 has 100"),
        (lambda: Poisson("many"), "full_well = many must be a positive number"),
        (lambda: Poisson(100, 17), "bits = 17 must be an integer 1..16"),
        (lambda: Poisson(100, 8.5), "bits = 8.5 must be"),
        (lambda: PoissonGaussian(100, 0), "read_noise = 0 must be.*Poisson"),
        (lambda: Gaussian(-1), "sigma = -1 must be"),
        (lambda: Poisson(100).from_codes(np.array([1])), "no ADC"),
        (lambda: Poisson(100, 8).from_codes(np.array([256])), r"code 256 is outside 0\.\.255"),
        (lambda: Poisson(100, 8).from_codes(np.array([-1])), "code -1 is outside"),
        (lambda: Poisson(100, 8).from_codes(np.array([0.5])), "dtype float64"),
        (lambda: Poisson(100).log_prob(0.5, jnp.ones(2, complex)), "complex.*intensity"),
        (lambda: Poisson(100).sample(jax.random.key(0), jnp.ones(2, complex)), "complex"),
    ],
)
def test_bad_arguments_are_named(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
