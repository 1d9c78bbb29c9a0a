"""Shared fixtures. Exactness is tested in float64; float32 where users run."""

import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def released():
    """Programs of a file are dropped after it: one process cannot map those of a thousand tests."""
    yield
    jax.clear_caches()


@pytest.fixture
def x64():
    """Run the test in double precision, without leaving the flag set for the next one."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=["float32", "float64"])
def precision(request):
    """Run the test in each precision; the value is the name of the real dtype."""
    with jax.enable_x64(request.param == "float64"):
        yield request.param
