"""Networks: shapes, exact inverses, gradients, and what preconditioning does at its limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from analytic import wiener

from posterior.models.priors import layers
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.ncsn import NCSNv2
from posterior.models.priors.storage import build_network
from posterior.models.priors.unet import UNet

SMALL = {
    "unet": {"type": "unet", "widths": [4, 6], "blocks": 1, "fine": 4},
    "ncsnv2": {"type": "ncsnv2", "width": 4, "blocks": 1},
}


def small(name, channels=1):
    return build_network(SMALL[name] | {"channels": channels}, jax.random.key(0))


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(12, 20)])
def test_output_has_the_shape_of_the_image(name, channels, size):
    network = small(name, channels)
    x = jax.random.normal(jax.random.key(1), (*size, channels))
    out = eqx.filter_jit(network)(x, jnp.zeros(()))
    assert out.shape == x.shape
    assert np.all(np.isfinite(out))


@pytest.mark.parametrize("name", SMALL)
def test_batch_is_the_same_as_one_by_one(name):
    network = small(name)
    x = jax.random.normal(jax.random.key(1), (3, 8, 8, 1))
    level = jnp.array([-2.0, 0.0, 1.0])
    batched = eqx.filter_jit(eqx.filter_vmap(network))(x, level)
    single = jnp.stack([eqx.filter_jit(network)(a, b) for a, b in zip(x, level)])
    np.testing.assert_allclose(batched, single, atol=2e-6)


@pytest.mark.slow
def test_width_and_depth_are_arguments():
    def size(network):
        return sum(a.size for a in jax.tree.leaves(network))

    key = jax.random.key(0)
    assert size(UNet(1, key, widths=(8, 8), blocks=2)) > size(UNet(1, key, widths=(8, 8)))
    assert size(UNet(1, key, widths=(8, 16))) > size(UNet(1, key, widths=(8, 8)))
    assert size(NCSNv2(1, key, width=8)) > size(NCSNv2(1, key, width=4))
    assert UNet(1, key, widths=(8, 8, 8)).stride == 8
    # The default is the small one that trains on a CPU.
    assert 0.6e6 < size(UNet(1, key)) < 0.7e6


def test_gathered_pixels_scatter_back():
    x = jnp.arange(4 * 6 * 3.0).reshape(4, 6, 3)
    gathered = layers.gather_pixels(x)
    assert gathered.shape == (2, 3, 12)
    np.testing.assert_array_equal(layers.scatter_pixels(gathered), x)
    # One output pixel holds one square of the input.
    np.testing.assert_array_equal(np.sort(gathered[0, 0]), np.sort(x[:2, :2].ravel()))


@pytest.mark.parametrize("dilation", [1, 2])
@pytest.mark.parametrize("side", [1, 3])
def test_frozen_convolution_has_the_same_gradients(x64, dilation, side):
    conv = layers.new_conv(2, 3, jax.random.key(0), side, dilation)
    conv = jax.tree.map(lambda a: a.astype(float), conv)
    x = jax.random.normal(jax.random.key(1), (6, 5, 2))
    weight = jax.random.normal(jax.random.key(2), (6, 5, 3))

    def gradients(conv):
        return jax.grad(lambda c, x: jnp.sum(weight * jnp.sin(c(x))), (0, 1))(conv, x)

    plain, quick = gradients(conv), gradients(layers.frozen(conv))
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(quick)):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


def test_preconditioning_at_its_limits():
    """Whatever the network says: no noise leaves the image, drowning noise leaves the mean."""
    statistics = Statistics(0.3, 0.2, 1e-4, 1e4)
    denoiser = Denoiser(small("unet"), statistics)
    x = 0.3 + jax.random.normal(jax.random.key(0), (8, 8, 1))
    np.testing.assert_allclose(denoiser(x, 1e-6), x, atol=1e-5)
    noisy = x + 1e4 * jax.random.normal(jax.random.key(1), x.shape)
    raw = denoiser.network((noisy - 0.3) / 1e4, jnp.log(jnp.float32(1e4 / 0.2)))
    np.testing.assert_allclose(denoiser(noisy, 1e4), 0.3 + 0.2 * raw, atol=1e-4)


@pytest.mark.parametrize("sigma", [0.02, 0.3, 4.0])
def test_network_sees_and_must_say_unit_variance(x64, sigma):
    """Input and target of F have variance 1 at every level, on data of the stated moments."""
    denoiser = wiener()
    clean = 0.3 + 0.25 * jax.random.normal(jax.random.key(0), (100_000, 1, 1))
    x = clean + sigma * jax.random.normal(jax.random.key(1), clean.shape)
    seen = (x - 0.3) / np.sqrt(sigma**2 + 0.25**2)
    target = (clean - denoiser(x, sigma)) * jnp.sqrt(denoiser.loss_weight(sigma))
    bound = 4 * np.sqrt(2 / clean.size)
    assert abs(seen.var() - 1) < bound
    assert abs(target.var() - 1) < bound


@pytest.mark.parametrize(
    "change, words",
    [
        ({"type": "resnet"}, "unknown network"),
        ({"widths": [8, 0]}, "must be 1 or more"),
        ({"depth": 3}, "depth"),
    ],
)
def test_bad_networks_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        build_network(SMALL["unet"] | {"channels": 1} | change, jax.random.key(0))


@pytest.mark.parametrize(
    "change, words",
    [
        ({"perturbation": "laplace"}, "unknown perturbation"),
        ({"perturbation": "signal", "complex_valued": True}, "for real objects"),
        ({"perturbation": "signal", "lowest": 0.0}, "positive floor"),
        ({"sigma_min": 2.0}, "positive and grow"),
        ({"sd": 0.0}, "must vary"),
    ],
)
def test_bad_statistics_are_refused(change, words):
    good = {"mean": 0.2, "sd": 0.2, "sigma_min": 0.01, "sigma_max": 1.0}
    with pytest.raises(ValueError, match=words):
        Statistics(**(good | change))
