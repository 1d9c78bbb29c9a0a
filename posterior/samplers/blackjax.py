"""Any BlackJAX algorithm, on the real view of the object."""

from collections.abc import Callable
from typing import Any, NamedTuple

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..models.realview import from_real, real_size, to_real
from ..problem import Posterior
from .base import Sampler

_WINDOWED = ("nuts", "hmc")


class BlackJAXState(NamedTuple):
    """BlackJAX's own state in the real view, and the algorithm's parameters."""

    inner: Any
    parameters: dict[str, jax.Array]
    posterior: Posterior


class BlackJAXInfo(NamedTuple):
    """Statistics of one step; NaN where the algorithm reports none."""

    acceptance_rate: jax.Array
    log_prob: jax.Array


class BlackJAX(Sampler):
    """Adapter: `BlackJAX(blackjax.nuts)`, `BlackJAX(blackjax.mala, step_size=0.01)`, ...

    BlackJAX is given the real view of the object, because it refuses complex positions (and its
    SGLD is silently wrong on them). NUTS and HMC are tuned in warm-up, each chain by itself, by
    BlackJAX's window adaptation; HMC needs `num_integration_steps`. For other algorithms give every
    parameter; array parameters (an inverse mass matrix) are in the real view.
    """

    algorithm: Any = eqx.field(static=True)
    parameters: dict[str, Any]

    def __init__(self, algorithm: Any, **parameters: Any):
        self.algorithm = algorithm
        self.parameters = {
            name: jnp.asarray(value) if _is_array(value) else value
            for name, value in parameters.items()
        }

    def tunes_itself(self) -> bool:
        """Whether BlackJAX's window adaptation knows this algorithm."""
        return any(self.algorithm is getattr(blackjax, name) for name in _WINDOWED)

    def init(
        self, key: jax.Array, posterior: Posterior, position: jax.Array | None = None
    ) -> BlackJAXState:
        """State at `position`, or at a dispersed start."""
        position = posterior.start(key) if position is None else position
        parameters = {k: v for k, v in self.parameters.items() if _is_array(v)}
        if self.tunes_itself():
            size = real_size(posterior.shape, posterior.dtype)
            dtype = position.real.dtype
            parameters.setdefault("step_size", jnp.asarray(0.1, dtype))
            parameters.setdefault("inverse_mass_matrix", jnp.ones(size, dtype))
        inner = self._build(posterior, parameters).init(to_real(position), key)
        return BlackJAXState(inner, parameters, posterior)

    def step(self, key: jax.Array, state: BlackJAXState) -> tuple[BlackJAXState, BlackJAXInfo]:
        """One step of the algorithm."""
        inner, info = self._build(state.posterior, state.parameters).step(key, state.inner)
        dtype = inner.position.dtype
        return state._replace(inner=inner), BlackJAXInfo(
            jnp.asarray(getattr(info, "acceptance_rate", jnp.nan), dtype),
            jnp.asarray(getattr(inner, "logdensity", jnp.nan), dtype),
        )

    def position(self, state: BlackJAXState) -> jax.Array:
        """The object of the real view."""
        return from_real(state.inner.position, state.posterior.shape, state.posterior.dtype)

    def own_warmup(self, key: jax.Array, state: BlackJAXState, steps: int) -> BlackJAXState:
        """One chain after BlackJAX's window adaptation of `steps` steps."""
        extra = {
            name: value
            for name, value in self.parameters.items()
            if name not in ("step_size", "inverse_mass_matrix")
        }
        warmup = blackjax.window_adaptation(
            self.algorithm,
            _log_density(state.posterior),
            # Of its steps nothing is kept; the default is everything.
            adaptation_info_fn=lambda *_: None,
            **extra,
        )
        result, _ = warmup.run(key, state.inner.position, steps)
        tuned = {k: v for k, v in result.parameters.items() if k in state.parameters}
        return state._replace(inner=result.state, parameters={**state.parameters, **tuned})

    def _build(self, posterior: Posterior, arrays: dict[str, jax.Array]) -> Any:
        fixed = {k: v for k, v in self.parameters.items() if not _is_array(v)}
        try:
            return self.algorithm(_log_density(posterior), **fixed, **arrays)
        except TypeError as error:
            raise ValueError(
                f"BlackJAX refuses the parameters {sorted({**fixed, **arrays})}: {error}"
            ) from error


def _log_density(posterior: Posterior) -> Callable[[jax.Array], jax.Array]:
    return lambda v: posterior.log_prob(from_real(v, posterior.shape, posterior.dtype))


def _is_array(value: Any) -> bool:
    return (
        isinstance(value, float) or eqx.is_array_like(value) and not isinstance(value, int | bool)
    )
