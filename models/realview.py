"""The real view: one real vector for an object that may be complex.

A complex object of shape S becomes concatenate(Re.ravel(), Im.ravel()), so that everything written
for real vectors (covariances, BlackJAX, emcee) works on it. A real object is only ravelled.
"""

import jax
import jax.numpy as jnp
import numpy as np


def is_complex(dtype: np.dtype) -> bool:
    """Whether objects of this dtype have an imaginary part."""
    return jnp.issubdtype(dtype, jnp.complexfloating)


def real_size(shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Number of real numbers in an object: its size, doubled if it is complex."""
    size = int(np.prod(shape))
    return 2 * size if is_complex(dtype) else size


def to_real(x: jax.Array) -> jax.Array:
    """Real view of one object: (size,), or (2 size,) if `x` is complex."""
    if jnp.iscomplexobj(x):
        return jnp.concatenate([x.real.ravel(), x.imag.ravel()])
    return x.ravel()


def from_real(v: jax.Array, shape: tuple[int, ...], dtype: np.dtype) -> jax.Array:
    """The object of this shape whose real view is `v`; precision follows `v`."""
    if is_complex(dtype):
        re, im = jnp.split(v, 2)
        return jax.lax.complex(re, im).reshape(shape)
    return v.reshape(shape)


def real_score(f_gradient: jax.Array) -> jax.Array:
    """Score df/dRe + j df/dIm from what `jax.grad` returns for real f (its conjugate)."""
    return jnp.conj(f_gradient)


def normal_like(key: jax.Array, x: jax.Array) -> jax.Array:
    """Standard normal noise shaped as `x`: unit variance, in Re and in Im each if complex."""
    if jnp.iscomplexobj(x):
        re, im = jax.random.normal(key, (2, *x.shape), x.real.dtype)
        return jax.lax.complex(re, im)
    return jax.random.normal(key, x.shape, x.dtype)
