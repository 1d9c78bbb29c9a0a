"""Dear sums where they are asked for: the values everywhere, the work only there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior.models.asked import where_asked


def _expected(asked, x):
    return jnp.where(asked, jnp.sin(x) * x, -1.0)


def _found(asked, x):
    return where_asked(lambda x: jnp.sin(x) * x, -1.0, asked, x)


@pytest.fixture
def pixels(x64):
    rng = np.random.default_rng(0)
    return jnp.asarray(rng.uniform(size=(5, 4, 9, 11)) < 0.3), jnp.asarray(
        rng.standard_normal((5, 4, 9, 11))
    )


# Which of two batches the question and the pixels have, as (axis, axis) each; outermost first.
BATCHES = [
    ((0, 0), (0, 0)),
    ((0, 0), (None, 0)),
    ((None, 0), (0, 0)),
    ((0, None), (0, 0)),
    ((0, 0), (0, None)),
    ((None, 0), (None, 0)),
    ((0, None), (None, 0)),
]


@pytest.mark.parametrize("outer, inner", BATCHES)
def test_batches_of_question_and_pixels(pixels, outer, inner):
    def picked(a, which):
        for axis in range(2):
            a = a if (outer, inner)[axis][which] is not None else a.take(0, axis=axis)[None]
            a = jnp.moveaxis(a, 0, axis) if (outer, inner)[axis][which] is None else a
        keep = [axis for axis in range(2) if (outer, inner)[axis][which] is None]
        return a.squeeze(tuple(keep))

    asked, x = picked(pixels[0], 0), picked(pixels[1], 1)
    batched = [jax.vmap(jax.vmap(f, inner), outer) for f in (_found, _expected)]
    np.testing.assert_array_equal(*(f(asked, x) for f in batched))
    np.testing.assert_array_equal(jax.jit(batched[0])(asked, x), batched[1](asked, x))


def test_derivatives(pixels):
    asked, x = pixels[0][0], pixels[1][0]

    def gradient(f):
        return jax.vmap(jax.grad(lambda x, a: jnp.sum(jnp.exp(f(a, x)))))

    np.testing.assert_allclose(
        gradient(_found)(x, asked), gradient(_expected)(x, asked), rtol=1e-12
    )

    def curvature(f):
        return jax.vmap(jax.hessian(lambda x, a: jnp.sum(jnp.exp(f(a, x)))))

    few = x[:, 0], asked[:, 0]
    np.testing.assert_allclose(curvature(_found)(*few), curvature(_expected)(*few), rtol=1e-12)


def test_only_what_is_asked_is_computed(pixels):
    computed = []

    def dear(x):
        jax.debug.callback(lambda: computed.append(x.size))
        return x

    asked, x = pixels
    one = jnp.zeros_like(asked).at[2, 3, 4, 5].set(True)
    run = jax.jit(jax.vmap(jax.vmap(lambda a, x: where_asked(dear, 0.0, a, x))))
    jax.block_until_ready(run(jnp.zeros_like(asked), x))
    assert computed == []
    jax.block_until_ready(run(one, x))
    jax.effects_barrier()
    assert computed == [32], "one block of pixels, of 1980"


@pytest.mark.parametrize("shape", [(), (0,), (1,), (33,), (3, 0, 2)])
def test_any_shape(shape):
    x = jnp.linspace(1.0, 2.0, int(np.prod(shape))).reshape(shape)
    for asked in (jnp.zeros(shape, bool), jnp.ones(shape, bool)):
        np.testing.assert_array_equal(_found(asked, x), _expected(asked, x))
